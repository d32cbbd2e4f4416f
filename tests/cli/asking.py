"""The command line as it answers within the tests' own process."""

from click.testing import Result
from typer.testing import CliRunner

from optipromp.cli.main import app


def asked(*words: object) -> Result:
    """What the command of these words did."""
    return CliRunner().invoke(app, [str(word) for word in words])
