"""Every shape in a signature is checked while the tests run."""

from importlib import import_module

import matplotlib as mpl
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

mpl.use("Agg")
install_import_hook("airtact", "checked_types.check")
settings.register_profile("airtact", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("airtact")

_kernels = import_module("airtact._kernels")  # after the hook


@pytest.fixture(params=_kernels.variants())
def variant(request):
    """Run a test with every instruction set that this machine has."""
    best = _kernels.active_variant()
    _kernels.use_variant(request.param)
    yield request.param
    _kernels.use_variant(best)
