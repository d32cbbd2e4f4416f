"""Pushing: which objects are in the way, what the tool does to them, and the path of the tool.

Rules give a side to pass each neighbour on. A model of the push predicts the harm of a tool path.
One search finds the candidate path of least harm in it. Two floors hold the models: ``stems`` for
fruits that hang, ``packs`` for what stands.
"""

from optipromp.pushing.candidates import Candidates as Candidates
from optipromp.pushing.candidates import Round as Round
from optipromp.pushing.candidates import Schedule as Schedule
from optipromp.pushing.interactive import Push as Push
from optipromp.pushing.interactive import pushes as pushes
from optipromp.pushing.model import Combined as Combined
from optipromp.pushing.model import Prediction as Prediction
from optipromp.pushing.model import PushModel as PushModel
from optipromp.pushing.packs.standing import Standing as Standing
from optipromp.pushing.path import ToolPath as ToolPath
from optipromp.pushing.path import through as through
from optipromp.pushing.rules import Drift as Drift
from optipromp.pushing.rules import DriftRule as DriftRule
from optipromp.pushing.rules import drift_choices as drift_choices
from optipromp.pushing.rules import neighbours as neighbours
from optipromp.pushing.rules import rule_paths as rule_paths
from optipromp.pushing.searching import search as search
from optipromp.pushing.stems.hanging import Hanging as Hanging
