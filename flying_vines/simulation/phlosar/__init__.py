"""The simulated phloSAR: the firmware on the plant, behind a pseudo-terminal."""


class FirmwareBuildError(Exception):
    """The firmware's core cannot be built or loaded here; the text says why."""
