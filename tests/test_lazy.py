"""Names of a package are imported by one thread at a time, because SciPy's packages are circular."""

from concurrent.futures import ThreadPoolExecutor

STUB = "from .first import one as one\nfrom .second import two as two\n"
MODULE = """
import time
import slowly
slowly.importing.append(__name__)
time.sleep(0.05)
assert slowly.importing == [__name__], "another module was being imported"
slowly.importing.remove(__name__)
one = 1
two = 2
"""


def test_two_threads_import_one_after_the_other(tmp_path, monkeypatch) -> None:
    package = tmp_path / "slowly"
    package.mkdir()
    (package / "__init__.py").write_text(
        "from airtact.lazy import attached\nimporting = []\n"
        "__getattr__, __dir__, __all__ = attached(__name__, __file__)\n",
        encoding="utf-8",
    )
    (package / "__init__.pyi").write_text(STUB, encoding="utf-8")
    for name in ("first", "second"):
        (package / f"{name}.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    import slowly

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(lambda name: getattr(slowly, name), ["one", "two"])) == [1, 2]
