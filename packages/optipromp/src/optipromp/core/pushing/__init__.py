"""Pushing: the objects in the way, push prediction, and the path of the tool.

Rules choose the side on which the tool passes each neighbour. A push model predicts the harm of a
tool path. The search finds the candidate path of least harm. The models: ``stems`` for fruits that
hang, ``packs`` for objects that stand.
"""

from optipromp.core.pushing.model import Candidates as Candidates
from optipromp.core.pushing.model import Combined as Combined
from optipromp.core.pushing.model import Prediction as Prediction
from optipromp.core.pushing.model import PushModel as PushModel
from optipromp.core.pushing.model import Round as Round
from optipromp.core.pushing.model import Schedule as Schedule
from optipromp.core.pushing.packs.standing import Standing as Standing
from optipromp.core.pushing.path import ToolPath as ToolPath
from optipromp.core.pushing.path import through as through
from optipromp.core.pushing.rules import Drift as Drift
from optipromp.core.pushing.rules import DriftRule as DriftRule
from optipromp.core.pushing.rules import Push as Push
from optipromp.core.pushing.rules import drift_choices as drift_choices
from optipromp.core.pushing.rules import neighbours as neighbours
from optipromp.core.pushing.rules import pushes as pushes
from optipromp.core.pushing.rules import rule_paths as rule_paths
from optipromp.core.pushing.searching import search as search
from optipromp.core.pushing.stems.hanging import Hanging as Hanging
