"""The report of a calibration: one self-contained HTML page, its plots as a PNG, and whether to believe the result."""

from calibration.report.page import check_extra, facts, write_report

__all__ = ["check_extra", "facts", "write_report"]
