"""``python -m airtact.cli`` is ``airtact``."""

import sys

from airtact.cli import main

if __name__ == "__main__":
    sys.exit(main())
