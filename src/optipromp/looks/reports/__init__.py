"""Reports: one self-contained HTML file about a plan or a study, for screens and for paper."""

from optipromp.looks.reports.plans import plan_report as plan_report
from optipromp.looks.reports.plans import run_report as run_report
from optipromp.looks.reports.studies import study_report as study_report
