"""The examples in the help of every command run as they are printed, in an empty folder."""

import re
import shlex

import click
import pytest

from airtact.cli import NAMES as COMMANDS
from airtact.cli import commands, main

# Their examples take seconds each
SECONDS = {
    "calibrate",
    "compare",
    "compare-scan",
    "emit",
    "live",
    "mesh",
    "place",
    "render",
    "sense",
    "sweep",
}

# The example of register waits for a person; tests/live/test_registering.py touches the boards.
NAMES = [
    pytest.param(name, marks=pytest.mark.slow) if name in SECONDS else name
    for name in COMMANDS
    if name != "register"
]


def command(name):
    found = commands.get_command(click.Context(commands), name)
    assert found is not None
    return found


def example(name):
    """Return the words of the one example in the help of a command, without the program."""
    (found,) = re.findall(r"Example: airtact (.*)", command(name).epilog or "")
    first, *rest = shlex.split(found)
    assert first == name
    return rest


@pytest.mark.parametrize("name", NAMES)
def test_the_example_of_a_command_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = example(name)
    if name == "emit":  # what render's example wrote
        assert main(["render", *example("render"), "--no-pictures"]) == 0
    if name == "place":
        words += ["--tries", "20"]  # the search of 2,000 layouts takes half a minute
    assert main([name, *words]) == 0
    capsys.readouterr()


def test_the_example_of_the_program_is_that_of_a_command():
    (found,) = re.findall(r"Example: airtact (.*)", commands.epilog or "")
    name, *words = shlex.split(found)
    assert words == example(name)
