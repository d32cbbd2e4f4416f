"""Random scenes by seed that an arm could solve, and the errors of a detector."""

from optipromp_sim.detection import NOISES as NOISES
from optipromp_sim.detection import Noise as Noise
from optipromp_sim.generate.generator import PANDA as PANDA
from optipromp_sim.generate.generator import PRESETS as PRESETS
from optipromp_sim.generate.generator import GenerationReport as GenerationReport
from optipromp_sim.generate.generator import Preset as Preset
from optipromp_sim.generate.generator import crop_of as crop_of
from optipromp_sim.generate.generator import generate as generate
from optipromp_sim.generate.generator import generate_with_report as generate_with_report
from optipromp_sim.generate.noise import noisy as noisy
from optipromp_sim.generate.noise import perceived as perceived
