"""``python -m clgrid`` is ``clgrid``."""

from clgrid.cli import main

main()
