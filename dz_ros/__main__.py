# SPDX-License-Identifier: Apache-2.0
"""``dz`` and ``python -m dz_ros``: an interrupt during start ends with one line, no traceback.

While Python itself starts, before the first line of this, an interrupt is Python's to answer, with
a traceback. ``dz`` (`scripts/dz`) therefore holds it back until `main` can answer;
``python -m dz_ros`` does not.
"""

import os
import sys


def main() -> int:
    """Run ``dz`` with the arguments of this process; return its exit code."""
    # Built in: signal imports others, and a folder could shadow it.
    import _signal  # type: ignore[import-not-found]

    def end(_number: int, _frame: object) -> None:
        os.write(2, b'dz: interrupted\n')
        os._exit(130)

    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, end)
    _signal.pthread_sigmask(_signal.SIG_UNBLOCK, (_signal.SIGINT,))
    from dz_ros.runtime.import_path import drop_current_folder

    drop_current_folder()
    from dz_ros.cli.main import main as dz

    try:
        code = dz()
        # Python notes an interrupt inside an exec of text (of a dataclass, while its module is
        # imported) and, run with -m, ends by SIGINT whatever is returned; the next exec of text
        # takes the note away.
        exec('')
        return code
    except KeyboardInterrupt:       # while the end of an earlier one, or of the program, was made
        os._exit(130)


if __name__ == '__main__':
    sys.exit(main())
