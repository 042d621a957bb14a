"""Write the report of a result."""

from pathlib import Path

from airtact.errors import of_kind, path_of
from airtact.files.atomic import writable_folder
from airtact.setup.comparing import MethodComparison
from airtact.setup.rendering import Rendering
from airtact.timing import Progress, no_progress


def write_report(
    result: Rendering | MethodComparison,
    folder: str | Path,
    *,
    progress: Progress = no_progress,
) -> tuple[Path, ...]:
    """Write the report of a result to a folder, replacing existing files of the same name.

    The .html page shows pictures, tables and warnings in any browser.

    Parameters
    ----------
    result : a rendering, as returned by ``render``, or a ``MethodComparison``, as returned by
        ``compare(setup)``. A rendering is written to report.html, and the field around its foci to
        field.vtkhdf for ParaView; a comparison is written to methods.html.
    folder : folder for the files; created if it does not exist.
    progress : function called with a description of each step as it begins.

    Returns
    -------
    The paths of the written files.

    Raises
    ------
    InvalidInput
        If the result has another type, or the folder cannot be written to.
    """
    # Importing Matplotlib takes a second, and only the pages require it.
    from airtact.reports.methods_page import write_methods_page
    from airtact.reports.run_page import write_run_page

    of_kind(result, Rendering | MethodComparison, "the result", "render(setup) or compare(setup)")
    folder = writable_folder(path_of(folder, "the folder"))
    if isinstance(result, MethodComparison):
        return write_methods_page(result, folder, progress)
    return write_run_page(result, folder, progress)
