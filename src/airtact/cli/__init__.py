"""The command line: each command parses, calls the workflow of its name, and prints.

Exit codes: 0 done, 1 a link to boards failed or known fields are not met, 2 bad input or not
converged, 130 interrupted by Ctrl-C. A message ends with the code of its kind of fault in brackets;
with ``--json`` it is written to the standard output as JSON too.
"""

import json
import sys
from collections.abc import Sequence

import click

import airtact as at
from airtact.cli import (
    boards,
    check,
    compare,
    compare_scan,
    emit,
    export,
    hand,
    init,
    live,
    mesh,
    render,
    selfcheck,
    sense,
    sweep,
)
from airtact.cli.sense.calibrate import calibrate


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line with these arguments, or those of this process, and return its exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    try:
        status = commands.main(args=given, prog_name="airtact", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return error.exit_code
    except click.ClickException as error:
        fault = _usage(error), "wrong_usage", error.exit_code
    except (KeyboardInterrupt, click.Abort) as stop:
        kept = str(stop.__cause__ or stop) or "finished files are complete"
        fault = f"interrupted; {kept}", "interrupted", 130
    except OSError as error:
        missing = isinstance(error, FileNotFoundError)
        sentence = f"{error.filename or 'a file'}: {error.strerror or error}"
        fault = sentence, "file_missing" if missing else "file_failed", 2
    except (
        at.InvalidInput,
        at.NotConverged,
    ) as error:  # imported only now, so that --help comes at once
        fault = str(error), error.code, 2
    except at.emission.LinkFailed as error:
        fault = str(error), error.code, 1
    else:
        return status or 0  # a command returns nothing, or ends with a code of its own
    return _fail(*fault, as_json="--json" in given)


def _usage(error: click.ClickException) -> str:
    """Write what is wrong with a command line, and where its options are listed."""
    context = error.ctx if isinstance(error, click.UsageError) else None
    sentence = error.format_message()
    return f"{sentence[:1].lower()}{sentence[1:]}{f' See {context.command_path} --help.' if context else ''}"


def _fail(sentence: str, code: str, status: int, as_json: bool) -> int:
    from airtact.errors import one_sentence

    sentence = one_sentence(sentence)
    click.echo(f"airtact: {sentence} [{code}]", err=True)
    if as_json:
        click.echo(json.dumps({"error": sentence, "code": code}, ensure_ascii=False))
    return status


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Example: airtact render pinch --out out/pinch",
)
@click.version_option(package_name="airtact", message="%(prog)s %(version)s")
def commands() -> None:
    """Compute what a phased array must emit so that a hand feels points while it scatters the sound."""


for _command in (
    *(
        boards.boards,
        check.check,
        compare.compare,
        compare_scan.compare_scan,
        emit.emit,
        export.export,
    ),
    *(
        hand.hand,
        init.init,
        live.live,
        mesh.mesh,
        render.render,
        sense.sense,
    ),
    *(selfcheck.selfcheck, sweep.sweep, calibrate),
):
    commands.add_command(_command)
