"""Every shape in a signature is checked while the tests run."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "2")

import matplotlib as mpl
from jaxtyping import install_import_hook

mpl.use("Agg")
install_import_hook("airtact", "beartype.beartype")
