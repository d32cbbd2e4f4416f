"""Random scenes by seed that an arm could solve, and the errors of a detector."""

from optipromp.scenes.generate.generator import PANDA as PANDA
from optipromp.scenes.generate.generator import PRESETS as PRESETS
from optipromp.scenes.generate.generator import GenerationReport as GenerationReport
from optipromp.scenes.generate.generator import Preset as Preset
from optipromp.scenes.generate.generator import generate as generate
from optipromp.scenes.generate.generator import generate_with_report as generate_with_report
from optipromp.scenes.generate.noise import NOISES as NOISES
from optipromp.scenes.generate.noise import Noise as Noise
from optipromp.scenes.generate.noise import noisy as noisy
from optipromp.scenes.generate.noise import perceived as perceived
