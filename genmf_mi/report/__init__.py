"""What a run shows for itself: ``before_after.png`` at first glance, ``report.html`` for everything else."""

from genmf_mi.report.model import Report, View
from genmf_mi.report.page import write_report
from genmf_mi.report.pictures import write_before_after

__all__ = ["Report", "View", "write_before_after", "write_report"]
