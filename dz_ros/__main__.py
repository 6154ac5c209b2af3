# SPDX-License-Identifier: Apache-2.0
"""``dz`` and ``python -m dz_ros``: an interrupt during start ends with one line, no traceback."""

import os
import sys

from dz_ros.runtime.import_path import drop_current_folder


def main() -> int:
    """Run ``dz`` with the arguments of this process; return its exit code."""
    drop_current_folder()
    import signal

    def end(_number: int, _frame: object) -> None:
        os.write(2, b'dz: interrupted\n')
        os._exit(130)

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, end)
    from dz_ros.cli.main import main as dz

    return dz()


if __name__ == '__main__':
    sys.exit(main())
