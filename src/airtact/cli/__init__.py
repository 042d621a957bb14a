"""The command line: each command parses its arguments, calls the library and prints the result.

Exit codes: 0 done, 1 a link to boards failed or known fields are not met, 2 bad input or not
converged, 130 interrupted by Ctrl-C. A message ends with the code of its kind of fault in brackets;
with ``--json`` it is written to the standard output as JSON too.
"""

import json
import sys
from collections.abc import Sequence
from importlib import import_module

import click

import airtact as at

# Commands; each is a function in the module of its name
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
    "render",
    "selfcheck",
    "sense",
    "sweep",
)


class Commands(click.Group):
    """A group whose commands are imported when they are run or listed."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of a command; None if there is no such command."""
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
    """Compute what a phased array must emit so that a hand in its sound feels points."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, with the arguments of this process by default; return the exit code."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    try:
        status = commands.main(args=arguments, prog_name="airtact", standalone_mode=False)
        return status or 0  # a command returns nothing, or ends with a code of its own
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return error.exit_code
    except click.ClickException as error:
        # Messages of click begin with a capital; those of airtact follow "airtact: ".
        sentence = error.format_message()
        sentence = sentence[:1].lower() + sentence[1:]
        if isinstance(error, click.UsageError) and error.ctx is not None:
            sentence += f" See {error.ctx.command_path} --help."
        code = "wrong_usage"
        status = error.exit_code
    except (KeyboardInterrupt, click.Abort) as stop:
        # A command that keeps results says so in the interrupt; click wraps it in Abort.
        sentence = f"interrupted; {str(stop.__cause__ or stop) or 'finished files are complete'}"
        code = "interrupted"
        status = 130
    except OSError as error:
        sentence = f"{error.filename or 'a file'}: {error.strerror or error}"
        code = "file_missing" if isinstance(error, FileNotFoundError) else "file_failed"
        status = 2
    # Naming these errors imports NumPy, which --help does not wait for.
    except (at.InvalidInput, at.NotConverged) as error:
        sentence = str(error)
        code = error.code
        status = 2
    except at.emission.LinkFailed as error:
        sentence = str(error)
        code = error.code
        status = 1
    return _fail(sentence, code, status, as_json="--json" in arguments)


def _fail(sentence: str, code: str, status: int, as_json: bool) -> int:
    from airtact.errors import one_sentence

    sentence = one_sentence(sentence)
    click.echo(f"airtact: {sentence} [{code}]", err=True)
    if as_json:
        click.echo(json.dumps({"error": sentence, "code": code}, ensure_ascii=False))
    return status
