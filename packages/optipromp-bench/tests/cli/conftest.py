"""The fixtures of the tests of commands."""

from tests.cli.fixtures import reach as reach
