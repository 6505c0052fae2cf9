"""``python -m wrapjax`` is the command ``wrapjax``."""

import sys

from wrapjax.cli import main

sys.exit(main())
