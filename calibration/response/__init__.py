"""The photometric response function of a camera: what it is, its file, what follows from it, whether it still holds."""

from calibration.response.function import FORMAT, GREY_LEVELS, ResponseFunction, is_number, load_response_document

__all__ = ["FORMAT", "GREY_LEVELS", "ResponseFunction", "is_number", "load_response_document"]
