"""Random scenes by seed that an arm could solve, and the errors of a detector."""

from optipromp.laboratory.detection import NOISES as NOISES
from optipromp.laboratory.detection import Noise as Noise
from optipromp.laboratory.generate.generator import PANDA as PANDA
from optipromp.laboratory.generate.generator import PRESETS as PRESETS
from optipromp.laboratory.generate.generator import GenerationReport as GenerationReport
from optipromp.laboratory.generate.generator import Preset as Preset
from optipromp.laboratory.generate.generator import crop_of as crop_of
from optipromp.laboratory.generate.generator import generate as generate
from optipromp.laboratory.generate.generator import generate_with_report as generate_with_report
from optipromp.laboratory.generate.noise import noisy as noisy
from optipromp.laboratory.generate.noise import perceived as perceived
