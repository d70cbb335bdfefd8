"""Run one notebook in a kernel of its own, in place: `python -m reproduction.execute NOTEBOOK`, as `reproduce` does.

It prints a line for each cell that has run. A process for each notebook is what lets nbclient do the rest: it ends its
kernel when this process is interrupted or terminated, and a kernel whose process is gone ends by itself.
"""

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

CELL_TIMEOUT = 600  # seconds; the slowest cell takes some ten
LONGEST_SOCKET = 98  # bytes of a path; with the number that Jupyter adds, macOS takes 103 and Linux 107


def through_files(folder):
    """Return the arguments by which a kernel's manager talks through sockets in a folder; {} where it cannot.

    Jupyter would choose free ports before the kernel opens them, and another program may take one in between: one run
    in some twenty, four at a time, waited for ever.
    """
    socket = os.path.join(folder, "ipc")
    if os.name != "posix" or len(os.fsencode(socket)) > LONGEST_SOCKET:
        return {}
    return {"transport": "ipc", "connection_file": os.path.join(folder, "kernel.json"), "ip": socket}


def settings_of_nobody(folder):
    """Return variables for a kernel, so that no result depends on the settings of whoever runs it.

    With them IPython and matplotlib find no settings but those of `folder`, which has none; IPython runs no code of the
    user's first and shows figures inline. matplotlib finds the list of fonts that it makes once for each user here: a
    kernel would tell in a cell's output that it makes one.
    """
    import matplotlib.font_manager

    style = folder / "matplotlibrc"
    style.touch()
    return {
        "IPYTHONDIR": str(folder / ".ipython"),
        "PYTHONSTARTUP": "",
        "MATPLOTLIBRC": str(style),
        "MPLBACKEND": "module://matplotlib_inline.backend_inline",
        "MPLCONFIGDIR": matplotlib.get_cachedir(),
    }


def own_python():
    """Return a finder of kernels that knows the Python of this environment only.

    Jupyter's own prefers kernels in the user's folder: one that is named python3 there would run the notebooks.
    """
    from ipykernel.kernelspec import get_kernel_dict
    from jupyter_client.kernelspec import KernelSpec, KernelSpecManager

    class OwnPython(KernelSpecManager):
        def get_kernel_spec(self, kernel_name):
            return KernelSpec(**get_kernel_dict())

    return OwnPython()


def tidied(notebook):
    """Return a notebook without what changes from run to run or from editor to editor.

    That is the version of Python, the name of the kernel as it is shown, and the times of the cells.
    """
    notebook["metadata"]["language_info"] = {"name": "python"}
    notebook["metadata"]["kernelspec"] = {"display_name": "Python 3", "language": "python", "name": "python3"}
    for cell in notebook["cells"]:
        cell["metadata"].pop("execution", None)
    return notebook


def execute(path):
    """Execute a notebook in its folder and write it back with its outputs.

    Returns nothing, or what is to be said of the cell that fails; then the file is left as it was.
    """
    # Or jsonschema, which nbformat imports, takes 0.9 s to make a grammar of web addresses: notebooks need none.
    sys.modules.setdefault("rfc3987_syntax", None)
    import nbformat
    from jupyter_client import AsyncKernelManager
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError

    notebook = nbformat.read(path, as_version=4)
    started = ["none"]  # the ids of the cells so far, or their numbers: before nbformat 4.5 cells have no ids
    with TemporaryDirectory(prefix="mpt-") as folder:
        client = NotebookClient(
            notebook,
            km=AsyncKernelManager(kernel_name="python3", kernel_spec_manager=own_python(), **through_files(folder)),
            timeout=CELL_TIMEOUT,
            kernel_name="python3",
            extra_arguments=["--IPKernelApp.log_level=50"],  # messages below level 50 do not concern the notebook
            shutdown_kernel="immediate",
            coalesce_streams=True,
            on_cell_start=lambda cell, cell_index: started.append(cell.get("id", cell_index + 1)),
            on_cell_executed=lambda cell, cell_index, execute_reply: print("executed", flush=True),
        )
        try:
            client.execute(cwd=str(path.parent))
        except CellExecutionError as error:
            return f"cell {started[-1]} failed: {error.ename}: {error.evalue}"
        except Exception as error:  # such as a kernel that dies
            return f"cell {started[-1]} failed: {error}"
    nbformat.write(tidied(notebook), path)
    return None


if __name__ == "__main__":
    sys.exit(execute(Path(sys.argv[1])))  # a text goes to stderr, with the exit code 1
