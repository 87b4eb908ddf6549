"""The command line of scripts: one clear line and exit code 1, as everywhere in clgrid."""

from __future__ import annotations

import argparse
import sys
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """Ends with one line that names the script and its help."""

    def error(self, message: str) -> NoReturn:
        sys.exit(f"{self.prog}: {message}; see {self.prog} --help")
