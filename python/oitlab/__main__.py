"""`python -m oitlab` is the command `oitlab`."""

import sys

from oitlab.cli import main

if __name__ == "__main__":
    sys.exit(main())
