"""A verdict as a page that convinces: pictures, tables and plain words, in one file that needs no network."""

from flying_vines.identification.report.figures import figures
from flying_vines.identification.report.write import write_report

__all__ = ["figures", "write_report"]
