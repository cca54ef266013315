"""``python -m tests.process_faults``."""

import sys

from tests.process_faults.table import main

sys.exit(main())
