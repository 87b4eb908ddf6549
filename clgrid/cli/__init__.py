"""The command line: arguments in, tables or JSON out; the work is done below.

Exit codes: 0 done, 1 usage or input error, 2 a comparison failed, 3 no usable device, 4 not all pictures of a
batch are there, 130 interrupted, 143 a batch ended by SIGTERM, 141 the reader of our output went away.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

import clgrid
from clgrid.cli import batch, bench, compare, devices, diff, info, render, report, repro, tradeoff, verify
from clgrid.cli.output import OutputClosedError
from clgrid.errors import ClgridError

app = typer.Typer(
    name="clgrid",
    help="Compact grids for ray tracing on OpenCL devices: build, cast, render, measure.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(render.render)
app.command()(batch.batch)
app.command()(bench.bench)
app.command()(info.info)
app.command()(verify.verify)
app.command()(compare.compare)
app.command()(diff.diff)
app.command()(repro.repro)
app.command()(tradeoff.tradeoff)
app.command()(report.report)
app.command()(devices.devices)
app.command()(devices.doctor)

# The base of all usage errors, which typer exports only by its heirs.
_UsageErrors = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"clgrid {clgrid.__version__}")
        raise typer.Exit()


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", callback=_show_version, is_eager=True),
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of an error; taken anywhere on the line.")
    ] = False,
) -> None:
    pass


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave the process with its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    end = given.index("--") if "--" in given else len(given)
    debug = "--debug" in given[:end]
    given = [word for k, word in enumerate(given) if k >= end or word != "--debug"]
    logging.basicConfig(format="clgrid: %(levelname)s: %(message)s", level=logging.WARNING)
    logging.addLevelName(logging.WARNING, "warning")
    sys.exit(_run(given or ["--help"], debug=debug))


def _run(arguments: list[str], *, debug: bool) -> int:
    """Run one command; every error becomes one line on stderr and an exit code."""
    try:
        code = app(arguments, prog_name="clgrid", standalone_mode=False)
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except (OutputClosedError, BrokenPipeError):
        # Nobody reads on: without this, flushing at exit would complain once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (KeyboardInterrupt, typer.Abort):
        return _fail("interrupted", 130)
    except Exception as error:
        if debug:
            raise
        return _explain(error)


def _explain(error: Exception) -> int:
    if isinstance(error, ClgridError):
        return _fail(str(error), error.exit_code)
    if isinstance(error, _UsageErrors):
        context = getattr(error, "ctx", None)
        path = context.command_path if context is not None else "clgrid"
        reason: str = error.format_message()  # type: ignore[attr-defined]
        return _fail(f"{reason.rstrip('.')}; see {path} --help", 1)
    if isinstance(error, MemoryError):
        return _fail("not enough memory; give a smaller scene, --density or --size", 1)
    return _fail(f"unexpected {type(error).__name__}: {error}; --debug shows where", 1)


def _fail(message: str, code: int) -> int:
    print(f"clgrid: error: {' '.join(message.split())}", file=sys.stderr)
    return code
