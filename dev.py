"""Set up napari-phase4d on this machine and run it: ``python3 dev.py demo``.

Needs nothing but Python 3.11 or newer. The first run installs the missing system libraries
(Debian and Ubuntu; elsewhere it prints what is missing), makes ``.venv`` next to this file and
installs the program and its test tools there. Later runs start at once.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
STAMP = VENV / "phase4d-setup"
MINIMUM_PYTHON = (3, 11)
#: Compiles what is not on disk yet.
WARM_UP = "from napari_phase4d.pipeline.ahead import warm_up; warm_up()"
#: Processes side by side share the cores, and each imports what another has compiled to bytecode.
SIDE_BY_SIDE = {"OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": ""}
#: Of tests at a time; each takes between one and two gigabytes.
MOST_PROCESSES = 4
#: Which of them are run, by what is asked for.
TESTS = {
    "": "not thorough",
    "--quick": "not gui and not slow and not thorough",
    "--thorough": "thorough",
}
XVFB_SCREEN = "-screen 0 1600x1000x24"
#: What makes napari, the plugin and the tests use the other Qt binding.
PYSIDE = {"QT_API": "pyside6", "PYTEST_QT_API": "pyside6"}

# Debian package -> the library whose absence shows that the package is missing.
QT_LIBRARIES = {
    "libegl1": "libEGL.so.1",
    "libglib2.0-0": "libglib-2.0.so.0",
    "libdbus-1-3": "libdbus-1.so.3",
    "libfontconfig1": "libfontconfig.so.1",
    "libxkbcommon-x11-0": "libxkbcommon-x11.so.0",
    "libxcb-cursor0": "libxcb-cursor.so.0",
    "libxcb-icccm4": "libxcb-icccm.so.4",
    "libxcb-keysyms1": "libxcb-keysyms.so.1",
    "libxcb-shape0": "libxcb-shape.so.0",
    "libgl1": "libGL.so.1",
}


def main() -> int:
    """Run the command that the user typed and return its exit code."""
    parser = argparse.ArgumentParser(prog="dev.py", description=__doc__.splitlines()[0])
    parser.add_argument(
        "command",
        choices=COMMANDS,
        help="; ".join(
            f"{k}: {v.__doc__.splitlines()[0].rstrip('.')}" for k, v in COMMANDS.items()
        ),
    )
    args, rest = parser.parse_known_args()
    if sys.version_info < MINIMUM_PYTHON:
        print(f"dev.py needs Python 3.11 or newer; this is {sys.version.split()[0]}.")
        return 2
    return COMMANDS[args.command](rest)


def demo(rest: list[str]) -> int:
    """Show the whole chain on a simulated hologram video."""
    setup([])
    # Without a display there is nobody to look at a window: run to the end and write pictures.
    mode = [] if has_display() else ["--headless"]
    return run_graphical(["-m", "napari_phase4d", "demo", *mode, *rest])


def test(rest: list[str]) -> int:
    """Run the tests, without those that take patience.

    With --quick only those that need no window and take no time, with --thorough only those that
    are left out without it. The story of the window is then told with the other Qt binding too.
    """
    setup([])
    chosen = TESTS.get(" ".join(rest))
    if chosen is None:  # arguments of one's own are for a closer look
        return run_graphical(["-m", "pytest", *rest])
    # What no process has compiled before, each of several would compile.
    run([str(python_in_venv()), "-c", WARM_UP], SIDE_BY_SIDE)
    # One process more than cores, as some of the tests wait.
    processes = str(min((os.cpu_count() or 1) + 1, MOST_PROCESSES))
    together = ["-m", "pytest", "-n", processes, "--dist", "worksteal", "-m", chosen]
    code = run_graphical(together, SIDE_BY_SIDE)
    if rest != ["--thorough"]:
        return code
    print("The story again, with PySide6:", flush=True)
    return code or run_graphical(["-m", "pytest", "-m", "story", "tests/_napari"], PYSIDE)


def check(rest: list[str]) -> int:
    """Check style and types."""
    setup([])
    commands = (
        ["-m", "ruff", "check", "."],
        ["-m", "ruff", "format", "--check", "."],
        ["-m", "mypy", *rest],
    )
    return max(run([str(python_in_venv()), *command]) for command in commands)


def bench(rest: list[str]) -> int:
    """Measure speed as ratios to other programs in the same run; --track saves and compares."""
    setup([])
    install_group("bench")
    if rest == ["--track"]:
        saved = ["--benchmark-autosave", "--benchmark-compare", "--benchmark-columns=median,iqr"]
        where = ["--rootdir=benchmarks", "--import-mode=prepend", "-p", "no:cacheprovider"]
        return run(
            [str(python_in_venv()), "-m", "pytest", *where, "benchmarks/test_tracking.py", *saved]
        )
    return run_graphical(["benchmarks/run.py", *rest])


def accuracy(rest: list[str]) -> int:
    """Measure how right each method is, against exact truth."""
    setup([])
    return run([str(python_in_venv()), "benchmarks/accuracy.py", *rest])


def docs(rest: list[str]) -> int:
    """Build the site of the documents; any warning is an error."""
    setup([])
    build = ["-m", "sphinx", "-W", "--keep-going", "-b", "html", "docs", "docs/_build/html"]
    return run_graphical([*build, *rest])


def looks(rest: list[str]) -> int:
    """Make the pictures anew that the window's five steps are compared with."""
    setup([])
    variables = {"PHASE4D_LOOKS_ANEW": "1"}
    return run_graphical(["-m", "pytest", "-n0", "tests/_napari/test_looks.py", *rest], variables)


def pictures(rest: list[str]) -> int:
    """Make the pictures of the documents from the real program."""
    setup([])
    return run_graphical(["docs/make_pictures.py", *rest])


def mutations(rest: list[str]) -> int:
    """Break important lines one by one and show that a test notices each."""
    setup([])
    return run_graphical(["benchmarks/mutations.py", *rest])


def matrix(rest: list[str]) -> int:
    """Test the wheel in fresh environments: Pythons, Qt bindings, newest and lowest versions."""
    setup([])
    install_group("release")
    return run([str(python_in_venv()), "tools/matrix.py", *rest])


def review(rest: list[str]) -> int:
    """Run the checks of .pre-commit-config.yaml and of scientific-python's sp-repo-review."""
    setup([])
    install_group("release")
    commands = (
        ["-m", "pre_commit", "run", "--all-files", *rest],
        ["-m", "repo_review", "."],
    )
    return max(run([str(python_in_venv()), *command]) for command in commands)


def napari(rest: list[str]) -> int:
    """Open napari with the Phase 4D dock."""
    setup([])
    return run_graphical(["-m", "napari", "-w", "napari-phase4d", "Phase 4D", *rest])


def setup(rest: list[str]) -> int:
    """Install what is missing, nothing else."""
    install_system_libraries()
    wanted = hashlib.sha256(
        (ROOT / "pyproject.toml").read_bytes() + sys.version.encode()
    ).hexdigest()
    if STAMP.exists() and STAMP.read_text() == wanted:
        return 0
    print("Setting up .venv (once, some minutes) ...", flush=True)
    subprocess.run([sys.executable, "-m", "venv", str(VENV)], check=True)
    pip = [
        str(python_in_venv()),
        "-m",
        "pip",
        "install",
        "-qq",
    ]  # warnings speak of the machine, not of the program
    subprocess.run([*pip, "--upgrade", "pip>=25.1"], check=True)
    subprocess.run([*pip, "--editable", str(ROOT), "--group", "dev"], check=True, cwd=ROOT)
    STAMP.write_text(wanted)
    return 0


def install_group(name: str) -> None:
    """Install what one command needs and the others don't."""
    pip = [str(python_in_venv()), "-m", "pip", "install", "-qq", "--group", name]
    subprocess.run(pip, check=True, cwd=ROOT)


def install_system_libraries() -> None:
    """Install the system packages that are missing, or stop and print the line that does."""
    missing = missing_packages()
    if not missing:
        return
    line = ["apt-get", "install", "--yes", "--no-install-recommends", *missing]
    is_root = hasattr(os, "geteuid") and os.geteuid() == 0
    # Nobody sits at a machine that only tests, and its sudo asks for no password.
    sudo = ["sudo"] if os.environ.get("CI") and shutil.which("sudo") and not is_root else []
    if not (shutil.which("apt-get") and (is_root or sudo)):
        command = shlex.join(["sudo", *line])
        names = ", ".join(missing)
        sys.exit(f"Missing system libraries: {names}.\nOn Debian or Ubuntu run:\n  {command}")
    print(f"Installing system libraries: {' '.join(missing)}", flush=True)
    quiet = {
        "stdout": subprocess.DEVNULL,
        "env": {**os.environ, "DEBIAN_FRONTEND": "noninteractive"},
    }
    subprocess.run([*sudo, "apt-get", "update"], check=True, **quiet)
    subprocess.run([*sudo, *line], check=True, **quiet)


def missing_packages() -> list[str]:
    """Return the Debian packages that this machine lacks (none on Windows and macOS)."""
    if not sys.platform.startswith("linux"):
        return []
    missing = [package for package, library in QT_LIBRARIES.items() if not loads(library)]
    if not any(Path("/usr").glob("lib*/**/dri/*.so")):
        missing.append("libgl1-mesa-dri")
    if not has_display():
        missing += [tool.lower() for tool in ("Xvfb", "xauth") if shutil.which(tool) is None]
    try:
        import ensurepip  # noqa: F401
    except ImportError:
        missing.append("python3-venv")
    return missing


def loads(library: str) -> bool:
    """Say whether a shared library can be loaded."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def has_display() -> bool:
    """Say whether there is a screen to open a window on."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def run_graphical(arguments: list[str], variables: dict[str, str] | None = None) -> int:
    """Run Python with these arguments, on a virtual screen where there is no real one."""
    command = [str(python_in_venv()), *arguments]
    if not has_display():
        command = ["xvfb-run", "-a", "-s", XVFB_SCREEN, *command]
    return run(command, variables)


def run(command: list[str], variables: dict[str, str] | None = None) -> int:
    """Run a command in the project's folder and return its exit code."""
    environment = {**os.environ, **(variables or {})}
    return subprocess.run(command, cwd=ROOT, check=False, env=environment).returncode


def python_in_venv() -> Path:
    """Return the interpreter of the project's environment."""
    return VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


ALL = (
    setup, demo, napari, test, check, docs, looks, pictures, bench, accuracy, mutations, matrix,
    review,
)  # fmt: skip
COMMANDS = {function.__name__: function for function in ALL}

if __name__ == "__main__":
    sys.exit(main())
