"""The report of a calibration: one HTML page that needs nothing else, and its plots as a PNG; whether to believe it."""

from calibration.report.page import check_extra, facts, write_report

__all__ = ["check_extra", "facts", "write_report"]
