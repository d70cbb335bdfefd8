"""A plugin for pytest: nbval's kernels talk through files, so that no two suites can meet at a port.

jupyter_client finds five ports that are free and leaves them to the kernel: another kernel, of tests that run beside
these, may take one before, and both wait for ever. Of two kernels that start at once on Linux that happens to one pair
in some 600, and of eight, two suites with four each, in one start of some twenty. Through files it cannot happen.

Each kernel still listens at one port of 127.0.0.1, for what its own subprocesses print. It asks the system for a free
one and keeps it, in one step, so that no other can get it.

On Windows, and where the path of a socket is longer than 98 bytes (a long TMPDIR), there are no such files. Then nbval
takes ports as ever, and two suites meet as often as above.
"""

import shutil
import weakref
from tempfile import mkdtemp

from jupyter_client import KernelManager

from reproduction.execute import through_files


def pytest_configure(config):
    """Let kernels use sockets that are files, but where there are none."""
    talk_through_files()


def talk_through_files():
    """Give each kernel that is started from now on a folder for its sockets, which goes when its manager does."""
    made = KernelManager.__init__

    def made_with_files(self, *args, **kwargs):
        if "transport" not in kwargs:  # as where this was called twice
            folder = mkdtemp(prefix="kernel-")
            # Not a TemporaryDirectory: nobody closes a manager, and it would warn in whichever test runs just then.
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
            kwargs = through_files(folder) | kwargs
        made(self, *args, **kwargs)

    KernelManager.__init__ = made_with_files
