"""A verdict as one page that needs no network: figures, tables and text."""

from flying_vines.identification.report.figures import figures
from flying_vines.identification.report.write import write_report

__all__ = ["figures", "write_report"]
