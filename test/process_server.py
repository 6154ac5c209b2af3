# SPDX-License-Identifier: Apache-2.0
"""Starts programs of this package for tests: real processes, copied from one that has imported.

Most of a start of ``python -m dz_ros`` or of a node are imports. The server makes them once and
forks; each program runs by its own entry, in its own session, with its own environment and
descriptors. It is asked by lines of JSON on a socket, ends with it, and kills what still runs.

``python process_server.py DESCRIPTOR``; `Server` is the other end.
"""

from contextlib import suppress
import gc
import importlib
import json
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import threading

from dz_ros.cli import forked

PROGRAMS = {'dz_ros', forked.PROGRAM}
"""Modules that ``-m`` may name."""
MODULES = (*forked.COMMON, 'dz_ros', 'dz_ros.__main__', 'dz_ros.cli.run',
           'dz_ros.cli.bag.replay', 'dz_ros.cli.shadow', 'dz_ros.cli.operator',
           'dz_ros.report.verdict', *(f'dz_ros.nodes.{name}_node' for name in (
               'actuator', 'replay', 'operator', 'check', 'live', 'feed')))
"""Modules that the server imports; not that of a node's program, which `dz run` runs itself."""
AT_START = ('LC_', 'LANG', 'PYTHON')
"""Environment variables, by their beginning, that Python reads when it starts; of them only
PYTHONPATH can be had later."""


class Server:
    """The server as its user sees it: `start`, `poll`; one for all tests of a worker."""

    def __init__(self):
        ours, theirs = socket.socketpair()
        self._process = subprocess.Popen(
            [sys.executable, __file__, str(theirs.fileno())], pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL, env={**os.environ, 'PYTHONUNBUFFERED': '1'},
            start_new_session=True)
        theirs.close()
        self._socket, self._lock = ours, threading.Lock()
        self._answers = ours.makefile('r')

    def start(self, words, environment, folder, output):
        """Start a program; return its process id."""
        return self._ask([output], words=words, environment=environment,
                         folder=os.fspath(folder or Path.cwd()))

    def poll(self, pid):
        """Return a program's exit code, None while it runs."""
        return self._ask([], poll=pid)

    def _ask(self, descriptors, **request):
        with self._lock:
            text = (json.dumps(request) + '\n').encode()
            socket.send_fds(self._socket, [text[:1]], descriptors)
            self._socket.sendall(text[1:])
            return json.loads(self._answers.readline())

    def close(self):
        """End it."""
        self._answers.close()
        self._socket.close()
        self._process.wait()


class Program(forked.Forked):
    """A program the server started: its parent, which alone can ask for its exit code."""

    def __init__(self, server, words, environment, folder):
        read, write = os.pipe()
        try:
            self.pid = server.start(words, environment, folder, write)
        finally:
            os.close(write)
        self._server, self.returncode = server, None
        self.stdout = os.fdopen(read, errors='replace')

    def poll(self):
        if self.returncode is None:
            self.returncode = self._server.poll(self.pid)
        return self.returncode


def can_start(words, given):
    """Return whether the server is to start this command with these variables of its own."""
    return (len(words) > 2 and sys.platform == 'linux' and words[1] == '-m'
            and words[0] == sys.executable and words[2] in PROGRAMS
            and not any(key.startswith(AT_START) for key in given if key != 'PYTHONPATH'))


def serve(connection):
    """Answer requests until the other end has gone."""
    for name in MODULES:
        with suppress(ImportError):
            importlib.import_module(name)
    gc.collect()
    gc.freeze()
    running = set()
    while True:
        text, descriptors, _, _ = socket.recv_fds(connection, 1, 1)
        if not text:
            break
        while not text.endswith(b'\n'):
            text += connection.recv(65536)
        request = json.loads(text)
        if 'poll' in request:
            pid, status = os.waitpid(request['poll'], os.WNOHANG)
            running.discard(pid)
            answer = os.waitstatus_to_exitcode(status) if pid else None
        else:
            answer = os.fork()
            if answer == 0:
                run(request, descriptors[0])
            os.close(descriptors[0])
            running.add(answer)
        connection.sendall((json.dumps(answer) + '\n').encode())
    for pid in running:
        os.kill(pid, signal.SIGKILL)


def run(request, output):
    """Run a program in this process, a copy, and end it."""
    code = 1
    try:
        forked.detach(request['environment'], (), output)
        os.chdir(request['folder'])
        sys.path[:0] = [place for place in os.environ.get('PYTHONPATH', '').split(os.pathsep)
                        if place and place not in sys.path]
        _, _, module, *words = request['words']
        forked.name_process(words[0], request['words'][2:])
        if module == 'dz_ros':
            program = sys.modules['dz_ros.__main__']
            sys.argv = [program.__file__, *words]
            code = program.main()
        else:
            program = importlib.import_module(module)
            sys.argv = [program.__file__, *words[1:]]
            code = program.run_node(words[0])
        gc.collect()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:  # noqa: BLE001  nothing of the server may run on
        sys.excepthook(*sys.exc_info())
    finally:
        for thread in threading.enumerate():
            if thread is not threading.current_thread() and not thread.daemon:
                thread.join()
        forked.leave(code)


if __name__ == '__main__':
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    serve(socket.socket(fileno=int(sys.argv[1])))
