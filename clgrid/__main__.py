"""``python -m clgrid`` is ``clgrid``."""

from clgrid.cli import main

# Processes that are spawned import this module under another name.
if __name__ == "__main__":
    main()
