"""Every shape in a signature is checked while the tests run."""

import matplotlib as mpl
from hypothesis import settings
from jaxtyping import install_import_hook

mpl.use("Agg")
install_import_hook("airtact", "checked_types.check")
settings.register_profile("airtact", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("airtact")
