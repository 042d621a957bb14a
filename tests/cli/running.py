"""The command line in this process: what it prints, done or rejected."""

from typing import Any

from airtact.cli import main


def output(capsys: Any, *arguments: object) -> tuple[int, str, str]:
    """Run a command; return its exit code and what it printed on both streams."""
    code = main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def done(capsys: Any, *arguments: object) -> tuple[str, str]:
    """Run a command that must succeed; return its words, over all lines and cells, and its steps."""
    code, printed, errors = output(capsys, *arguments)
    assert code == 0, errors
    return " ".join(printed.split()), errors


def rejected(capsys: Any, *arguments: object) -> str:
    """Run a command that must be rejected with exit code 2; return the last line that it printed."""
    code, _, errors = output(capsys, *arguments)
    assert code == 2, errors
    assert "Traceback" not in errors
    return errors.splitlines()[-1]
