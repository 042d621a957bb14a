"""The command line: each command parses, calls the workflow of its name, and prints.

Exit codes: 0 done, 1 a link to boards failed, 2 bad input or not converged, 130 interrupted by Ctrl-C. A message ends
with the code of its kind of fault in brackets.
"""

from collections.abc import Sequence

import click

import airtact as at
from airtact.cli import bench, boards, check, compare, compare_scan, emit, export, hand, listen, mesh, render, reproduce


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line with these arguments, or those of this process, and return its exit code."""
    try:
        commands.main(args=arguments, prog_name="airtact", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (KeyboardInterrupt, click.Abort):
        return _fail("interrupted; finished files are complete", "interrupted", 130)
    except OSError as error:
        missing = isinstance(error, FileNotFoundError)
        sentence = f"{error.filename or 'a file'}: {error.strerror or error}"
        return _fail(sentence, "file_missing" if missing else "file_failed", 2)
    except (at.InvalidInput, at.NotConverged) as error:  # imported only now, so that --help comes at once
        return _fail(str(error), error.code, 2)
    except at.emission.LinkFailed as error:
        return _fail(str(error), "link_failed", 1)
    return 0


def _fail(sentence: str, code: str, status: int) -> int:
    click.echo(f"airtact: {sentence} [{code}]", err=True)
    return status


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Example: airtact render pinch --out out/pinch",
)
@click.version_option(package_name="airtact", message="%(prog)s %(version)s")
def commands() -> None:
    """Compute what a phased array must emit so that a hand feels points while it scatters the sound."""


for _command in (
    *(bench.bench, boards.boards, check.check, compare.compare, compare_scan.compare_scan, emit.emit, export.export),
    *(hand.hand, listen.listen, mesh.mesh, render.render, reproduce.reproduce),
):
    commands.add_command(_command)
