"""`python -m solari_vk` is the command line."""

import sys

from solari_vk.cli import main

sys.exit(main())
