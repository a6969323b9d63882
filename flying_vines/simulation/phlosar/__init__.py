"""The simulated phloSAR: the firmware on the plant, behind a pseudo-terminal."""


class FirmwareBuildError(Exception):
    """The firmware's core could not be built or loaded here; says why in a sentence."""
