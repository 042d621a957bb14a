"""``airtact sweep``: what the foci of a scene get while keys of its file vary."""

from airtact.cli.sweep.command import sweep as sweep
