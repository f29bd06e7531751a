"""Reports on one or several run folders, as one HTML file that needs no network. Needs `evogymcm[report]`."""

from evogymcm.report.page import make_report, write_report

__all__ = ["make_report", "write_report"]
