"""Sphinx configuration of the documentation site, built by ``make docs``."""

import inspect
import re
from pathlib import Path
from types import ModuleType
from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util import logging

import airtact

project = "airtact"
author = "The airtact developers"
version = release = airtact.__version__

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_copybutton",
]
html_theme = "furo"
html_title = f"airtact {release}"
html_math_renderer = "mathml"
html_show_sphinx = False
html_show_copyright = False
exclude_patterns = ["_build"]

nb_execution_mode = "force"  # the notebooks are stored without outputs
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4
copybutton_exclude = ".linenos, .gp, .go"

autodoc_class_signature = "mixed"
autodoc_default_options = {
    "members": True,
    "special-members": "__init__",
    "member-order": "bysource",
}
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
autosummary_generate = False
numpydoc_show_class_members = False  # autodoc shows them

# A reference without a target is an error. These packages are not documented here.
nitpicky = True
nitpick_ignore_regex = [
    (r"py:.*", r"msgspec\..*"),
    (
        "py:.*",
        r"(collections|concurrent|dataclasses|jaxtyping|matplotlib|mpl_toolkits|numpy|np|pathlib|types|typing)\..*",
    ),
    ("py:.*", "ndarray|optional|Path"),
    # Private classes of shapes and fields. Users see a field as a ``RadiatedField``.
    ("py:.*", r"airtact\.(geometry\.mesh|hands|acoustics\.solvers)\.\w+\..*"),
    ("py:.*", r"airtact\.acoustics\.solvers\.free_field\..*"),
    (
        "py:.*",
        r"airtact\.live\.(drives|page)\..*",
    ),  # processes that ``airtact live`` starts beside the loop
]

logger = logging.getLogger(__name__)

REFERENCE = Path(__file__).parent / "reference"


def namespaces() -> list[ModuleType]:
    """Return ``airtact`` and its public namespaces."""
    return [
        airtact,
        *(value for name in airtact.__all__ if inspect.ismodule(value := getattr(airtact, name))),
    ]


def directive(name: str, member: Any) -> str:
    """Return the autodoc directive that documents a name."""
    kind = (
        "class" if inspect.isclass(member) else "function" if inspect.isroutine(member) else "data"
    )
    if inspect.isclass(member) and issubclass(member, BaseException):
        kind = "exception"
    return f".. auto{kind}:: {name}\n"


def write_reference() -> None:
    """Write one page per namespace: a table of its names, and those not documented on an earlier page."""
    REFERENCE.mkdir(exist_ok=True)
    homes: dict[int, str] = {}
    pages = {}
    for module in namespaces():
        title, own, table = module.__name__, [], []
        for name in sorted(module.__all__, key=str.lower):
            if inspect.ismodule(getattr(module, name)):
                continue
            member, full = getattr(module, name), f"{title}.{name}"
            if id(member) not in homes:
                homes[id(member)] = full
                own.append(directive(full, member))
            table.append(f"   ~{homes[id(member)]}")
        text = f".. automodule:: {title}\n   :no-members:\n\n.. currentmodule:: None\n"
        rows = ".. autosummary::\n   :nosignatures:\n\n" + "\n".join(table) + "\n"
        pages[f"{title}.rst"] = "\n".join([title, "=" * len(title), "", text, rows, *own])
    contents = "".join(f"   {page[:-4]}\n" for page in pages)
    pages["index.rst"] = "Reference\n=========\n\n.. toctree::\n\n" + contents
    for old in REFERENCE.glob("*.rst"):
        if old.name not in pages:
            old.unlink()
    for page, text in pages.items():
        path = REFERENCE / page
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def mathml(translator: Any, node: nodes.Element) -> None:
    """Write a formula as MathML, which browsers show without a script."""
    block = isinstance(node, nodes.math_block)
    try:
        translator.body.append(latex2mathml.tex2mathml(node.astext(), as_block=block))
    except Exception as fault:
        logger.warning("formula not understood: %s", fault, location=node)
    raise nodes.SkipNode


def named_first(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Move the text after ``name : `` to its own line, because numpydoc would take it for a type."""
    heading, found = "", []
    for at, line in enumerate(lines):
        after = lines[at + 1] if at + 1 < len(lines) else ""
        if after and set(after.strip()) == {"-"}:
            heading = line.strip()
        match = re.match(r"(\s*)([\w*][\w*, ]*) : (.*)", line)
        if match and heading in ("Parameters", "Attributes"):
            found += [match[1] + match[2], f"{match[1]}    {match[3]}"]
        else:
            found.append(line)
    lines[:] = found


def plain_bars(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Escape bars, so that |x| is a magnitude and not a substitution."""
    code = False
    for at, line in enumerate(lines):
        code = line.lstrip().startswith(">>>") or (code and bool(line.strip()))
        if not code:
            parts = line.split("``")
            lines[at] = "``".join(
                part if odd % 2 else part.replace("|", r"\|") for odd, part in enumerate(parts)
            )


def signature(
    app: Sphinx,
    what: str,
    name: str,
    obj: object,
    options: object,
    arguments: str | None,
    result: str | None,
) -> tuple[str | None, str | None]:
    """Show default factories of dataclasses as dots, which Sphinx can parse."""
    return arguments and arguments.replace("<factory>", "..."), result


def written_by_dataclass(
    app: Sphinx, what: str, name: str, obj: Any, skip: bool, options: object
) -> bool | None:
    """Leave out the ``__init__`` that a dataclass generates."""
    return True if name == "__init__" and obj.__code__.co_filename == "<string>" else None


def private_type(app: Sphinx, domain: object, node: nodes.Element) -> bool:
    """Name the signature that shows an undocumented type; the warning of Sphinx has no location."""
    above = node.parent
    while above is not None and not isinstance(above, addnodes.desc_signature):
        above = above.parent
    if above is None:
        return False
    logger.warning(
        "signature of %s shows %s, which is not public", above["ids"][0], node["reftarget"]
    )
    return True


def setup(app: Sphinx) -> None:
    """Write the reference before Sphinx looks for pages."""
    write_reference()
    app.connect("autodoc-process-docstring", named_first, priority=100)  # before numpydoc
    app.connect("autodoc-process-docstring", plain_bars, priority=900)  # after numpydoc
    app.connect("autodoc-process-signature", signature)
    app.connect("autodoc-skip-member", written_by_dataclass)
    app.connect("warn-missing-reference", private_type)
    app.add_html_math_renderer("mathml", (mathml, None), (mathml, None))
