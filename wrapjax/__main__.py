"""``python -m wrapjax`` is the command ``wrapjax``."""

import sys

from wrapjax.cli.command_line import main

sys.exit(main())
