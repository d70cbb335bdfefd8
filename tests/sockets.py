"""A plugin for pytest: nbval's kernels talk through files, so that no two suites can meet at a port.

jupyter_client finds ports that are free and leaves them to the kernel: another kernel, of tests that run beside these,
may take one before.
"""

import shutil
import weakref
from tempfile import mkdtemp

from jupyter_client import KernelManager

from reproduction.execute import through_files


def pytest_configure(config):
    """Let kernels use sockets that are files; where they cannot, they keep to ports."""
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
