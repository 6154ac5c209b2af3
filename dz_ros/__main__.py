"""``python -m dz_ros`` is ``dz``."""

import sys

from dz_ros.cli.main import main

if __name__ == '__main__':
    sys.exit(main())
