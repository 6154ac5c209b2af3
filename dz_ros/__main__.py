# SPDX-License-Identifier: Apache-2.0
"""``dz`` and ``python -m dz_ros``: an interrupt during start ends with one line, no traceback.

While Python itself starts, before the first line of this, an interrupt is Python's to answer, with
a traceback. ``dz`` (`scripts/dz`) therefore holds it back until `main` can answer;
``python -m dz_ros`` does not.
"""

import atexit
import os
import sys

INTERRUPTED = 130       # as in dz_ros.cli.interrupt, which takes long to import


def main() -> int:
    """Run ``dz`` with the arguments of this process; return its exit code."""
    # Built in: signal imports others, and a folder could shadow it.
    import _signal  # type: ignore[import-not-found]

    code = 0

    def end(_number: int, _frame: object) -> None:
        os.write(2, b'dz: interrupted\n')
        os._exit(INTERRUPTED)

    def leave() -> None:
        # What was interrupted half-made, such as code being compiled, can crash Python as it takes
        # its modules down. The first function registered runs when all others have.
        if code == INTERRUPTED:
            from contextlib import suppress

            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError):
                    stream.flush()
            os._exit(code)

    atexit.register(leave)
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
        os._exit(INTERRUPTED)


if __name__ == '__main__':
    sys.exit(main())
