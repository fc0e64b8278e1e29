"""The report of a run: one HTML file that needs no network, also of a run that was killed."""

from robbie_mp.logs.report.report import report_of
from robbie_mp.logs.report.run_files import NoResults, ReportedRun, choose_results, read_run

__all__ = ["NoResults", "ReportedRun", "choose_results", "read_run", "report_of"]
