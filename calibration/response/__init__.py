"""The photometric response function of a camera: what it is, its file, what follows from it, whether it still holds."""

from calibration.response.function import GREY_LEVELS, ResponseFunction, greys_of_codes

__all__ = ["GREY_LEVELS", "ResponseFunction", "greys_of_codes"]
