"""From the name of a paper to its experiment, computed again. Prints nothing."""

from pathlib import Path

from airtact.experiments import inoue2014
from airtact.experiments.inoue2014 import Reproduced
from airtact.timing import Progress, no_progress

PAPERS = {"inoue2014": inoue2014.reproduce}
"""The papers by name."""


def reproduce(paper: str, folder: Path, quick: bool = False, report_step: Progress = no_progress) -> Reproduced:
    """Compute the experiment of one of ``PAPERS`` again and write a page about it into a folder.

    Raises
    ------
    InvalidInput, NotConverged
        As the paper's own ``reproduce``.
    """
    return PAPERS[paper](folder, quick, report_step)
