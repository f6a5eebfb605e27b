"""Every error this package raises on purpose has one root; command lines print it as one line."""


class DlscQbsError(Exception):
    """Root of all expected errors."""


class ConfigError(DlscQbsError):
    """A parameter is unknown, of the wrong type or out of its range."""


class ImageError(DlscQbsError):
    """An image message cannot be decoded as it stands."""


class StampError(DlscQbsError):
    """A stamp is not after the one before it."""


class OdometryError(DlscQbsError):
    """An odometry message holds no usable pose."""


class RecordingError(DlscQbsError):
    """A recording is missing, cut, foreign or lacks what was asked of it."""


class MapError(DlscQbsError):
    """A map is missing, damaged, foreign or made with another configuration."""


class ModelError(DlscQbsError):
    """A file of a network is missing, damaged or not of the kind that was asked for."""
