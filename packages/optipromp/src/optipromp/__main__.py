"""``python -m optipromp`` is the command ``optipromp``."""

from optipromp.cli.main import main

main()
