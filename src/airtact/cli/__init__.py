"""The command line: each command parses its arguments, calls the library and prints the result.

The exit code is 0 for success, 1 if a link to boards or the self-check fails, 2 for bad
input or no convergence, and 130 for an interruption by Ctrl-C. An error message ends
with its code in brackets. With ``--json``, the error is also written to standard output as JSON.
"""

import atexit
import gc
import json
import os
import sys
from collections.abc import Sequence
from importlib import import_module

import click

import airtact as at

# Each command is a function in the module with the same name.
NAMES = (
    "boards",
    "calibrate",
    "check",
    "compare",
    "compare-scan",
    "emit",
    "hand",
    "init",
    "live",
    "mesh",
    "place",
    "reach",
    "register",
    "render",
    "selfcheck",
    "sense",
    "sweep",
    "why",
)


class Commands(click.Group):
    """Click group that imports a command only when it is run or listed."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; return None for an unknown name."""
        if cmd_name not in NAMES:
            return None
        name = cmd_name.replace("-", "_")
        return getattr(import_module(f"airtact.cli.{name}"), name)


@click.group(
    cls=Commands,
    commands=dict.fromkeys(NAMES),  # pyright: ignore[reportArgumentType] (their names are listed)
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Example: airtact render pinch --out out/pinch",
)
@click.version_option(package_name="airtact", message="%(prog)s %(version)s")
def commands() -> None:
    """Compute the drive of an ultrasonic phased array that focuses on a hand."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, by default with this process's arguments, and return the exit code."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    # Idle threads of OpenBLAS would spin for 30 ms after each product, on the kernels' processors.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    # Imports create many permanent objects; searching them for garbage takes a tenth of the start.
    gc.set_threshold(100_000)
    # At exit, Python would search all of them once more, which takes up to 0.3 s.
    atexit.register(gc.freeze)
    status = 2
    try:
        # The group returns None, or the exit code of a command.
        return commands.main(args=arguments, prog_name="airtact", standalone_mode=False) or 0
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return error.exit_code
    except click.ClickException as error:
        # click's messages begin with a capital letter, but airtact's follow "airtact: ".
        sentence = error.format_message()
        sentence = sentence[:1].lower() + sentence[1:]
        if isinstance(error, click.UsageError) and error.ctx is not None:
            sentence += f" See {error.ctx.command_path} --help."
        code = "wrong_usage"
        status = error.exit_code
    except (KeyboardInterrupt, click.Abort) as stop:
        # The interrupt raised by a command names the complete files; click wraps it in Abort.
        sentence = f"interrupted; {str(stop.__cause__ or stop) or 'finished files are complete'}"
        code = "interrupted"
        status = 130
    except OSError as error:
        sentence = f"{error.filename or 'a file'}: {error.strerror or error}"
        code = "file_missing" if isinstance(error, FileNotFoundError) else "file_failed"
    except ImportError as error:
        if "_kernels" not in str(error):
            raise
        sentence = (
            "the compiled part of airtact is missing, because this source folder was not built: "
            "run pip install . in the checkout, and do not add src to PYTHONPATH"
        )
        code = "extra_missing"
    # Naming these errors imports NumPy, so --help must not reach this line.
    except (at.InvalidInput, at.NotConverged) as error:
        sentence = str(error)
        code = error.code
    except at.emission.LinkFailed as error:
        sentence = str(error)
        code = error.code
        status = 1
    from airtact.errors import one_sentence

    sentence = one_sentence(sentence)
    click.echo(f"airtact: {sentence} [{code}]", err=True)
    if "--json" in arguments:
        click.echo(json.dumps({"error": sentence, "code": code}))
    return status
