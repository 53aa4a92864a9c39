"""``python -m genmf_mi`` is ``genmf-mi``."""

import sys

from genmf_mi.cli import main

sys.exit(main())
