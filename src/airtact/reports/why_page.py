"""The page that explains weak foci, with a waterfall chart of the causes for each focus."""

from pathlib import Path
from typing import Any

from airtact.reports.page import write_page
from airtact.setup.explaining import MODULATED, Explanation


def write_why_page(path: Path, explained: Explanation, title: str, text: str) -> None:
    """Write a page that explains the pressure at each focus, replacing an existing file.

    Parameters
    ----------
    path : HTML file to write.
    explained : explanation of the pressures, as returned by ``why``.
    title, text : name and content of the scene file.
    """
    last = explained.causes[-1].pressures
    weakest = explained.weakest
    remedies = {cause.name: cause.remedy for cause in explained.causes if cause.remedy}
    write_page(
        path,
        "why.html.j2",
        title=f"airtact: why {title}",
        name=title,
        advice=explained.advice,
        charts=[_waterfall(explained, focus) for focus in range(len(explained.foci))],
        headline=f"{last[weakest]:,.0f} Pa of {explained.causes[0].pressures[weakest]:,.0f} Pa "
        f"remain at the weakest focus, {explained.foci[weakest]}.",
        rms=f"; from “{MODULATED}” onward, they are the root mean square of the peak pressure "
        "over time"
        if MODULATED in (cause.name for cause in explained.causes)
        else "",
        header=["focus", *(f"{cause.name} [Pa]" for cause in explained.causes)],
        rows=[
            [name, *(f"{cause.pressures[focus]:,.0f}" for cause in explained.causes)]
            for focus, name in enumerate(explained.foci)
        ],
        remedies=[[name, remedy] for name, remedy in remedies.items()],
        text=text,
    )


def _waterfall(explained: Explanation, focus: int) -> dict[str, Any]:
    """Return the bars for one focus: name, start and length [%], pressure, and change as text."""
    pressures = [float(cause.pressures[focus]) for cause in explained.causes]
    largest = max(pressures)
    bars = []
    before = 0.0
    for index, (cause, after) in enumerate(zip(explained.causes, pressures, strict=True)):
        kind = "total" if not bars else "loss" if after < before else "gain"
        bars.append(
            {
                "name": cause.name,
                "kind": kind,
                "start": 100.0 * min(before, after) / largest,
                "length": 100.0 * abs(after - before) / largest,
                "pressure": f"{after:,.0f} Pa",
                "change": explained.change_in_words(index, focus),
            }
        )
        before = after
    share = 100.0 * before / largest
    words = f"{before:,.0f} Pa"
    end = {"name": "remaining pressure", "kind": "total", "start": 0.0, "length": share}
    bars.append({**end, "pressure": words, "change": ""})
    return {"focus": explained.foci[focus], "bars": bars, "words": words}
