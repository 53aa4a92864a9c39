"""``python -m genmf_mi`` is ``genmf-mi``."""

import sys

from genmf_mi.cli.main import main

sys.exit(main())
