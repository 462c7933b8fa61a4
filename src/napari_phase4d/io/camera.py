"""A camera that Micro-Manager drives: its frames as files, each as soon as it has come."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.video import colour_sentence, grey
from napari_phase4d.later import tifffile
from napari_phase4d.words import as_path, shown

__all__ = ["FromCamera"]

#: Seconds between two looks into the camera's buffer while nothing is there.
LOOK_S = 0.002
#: Megabytes of frames that the camera may be ahead of the disk.
BUFFER_MB = 512
#: How files of frames are called.
NAME = "frame_{:06}.tif"


class FromCamera:
    """Writes the frames of a camera into a folder, for `napari_phase4d.pipeline.watch`.

    A thread takes each frame from the buffer of Micro-Manager and writes it as a TIFF file, which
    gets its name when it is whole. So what is done with the frames may take its time, and they
    stay as a recording that can be run again. Frames are numbered by the camera: those that its
    buffer had no room for are missing in the numbers.

    It is a context manager: the camera runs inside of ``with``; `watch` does that by itself.

    Parameters
    ----------
    core : pymmcore_plus.CMMCorePlus
        With a camera, its exposure and region set; see `configured`.
    folder : str or Path
        Where the frames go; made if it is not there, and it must hold none.
    frames : int, optional
        How many to take. Default: until it is told to end.

    Raises
    ------
    TypeError, ValueError
        If there is no camera, or the number can't be.

    See Also
    --------
    napari_phase4d.pipeline.watch : Works on the frames as they come.
    """

    def __init__(self, core: Any, folder: str | Path, frames: int | None = None) -> None:
        wanted = ("startSequenceAcquisition", "popNextImageAndMD", "getCameraDevice")
        if not all(hasattr(core, name) for name in wanted):
            msg = f"core must be a CMMCorePlus of pymmcore-plus, but is {shown(core)}"
            raise TypeError(msg)
        if frames is not None and (not isinstance(frames, int) or frames < 1):
            msg = f"frames must be a number of frames, 1 or more, but is {shown(frames)}"
            raise ValueError(msg)
        if not core.getCameraDevice():
            msg = "Micro-Manager has no camera; load a configuration with one"
            raise ValueError(msg)
        self.core, self.folder, self.frames = core, as_path(folder), frames
        #: Frames that are files by now.
        self.written = 0
        #: Frames that the camera took and its buffer had no room for.
        self.dropped = 0
        self._error: Exception | None = None
        self._told = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="camera", daemon=True)

    @classmethod
    def configured(
        cls, configuration: str | Path, folder: str | Path, frames: int | None = None
    ) -> FromCamera:
        """Return the camera of a configuration file of Micro-Manager.

        Parameters
        ----------
        configuration : str or Path
            A ``.cfg`` file; "demo" for the simulated camera of Micro-Manager.
        folder, frames
            See the class.

        Raises
        ------
        ImportError
            If pymmcore-plus is not installed.
        OSError
            If the configuration can't be loaded.
        """
        try:
            from pymmcore_plus import CMMCorePlus
        except ImportError as error:
            msg = (
                "a camera needs pymmcore-plus, which is not installed; "
                'pip install "napari-phase4d[camera]"'
            )
            raise ImportError(msg) from error
        core = CMMCorePlus()
        try:
            core.loadSystemConfiguration(
                "MMConfig_demo.cfg" if str(configuration) == "demo" else str(configuration)
            )
        except (OSError, RuntimeError) as error:
            why = " ".join(str(error).split())
            msg = f"the configuration {configuration} can't be loaded ({why})"
            raise OSError(msg) from error
        return cls(core, folder, frames)

    def __enter__(self) -> Self:
        """Start the camera."""
        self.folder.mkdir(parents=True, exist_ok=True)
        there = next((p.name for p in self.folder.iterdir() if counts(p.name)), None)
        if there is not None:
            msg = f"{self.folder} holds {there} already; choose an empty folder for the frames"
            raise OSError(msg)
        try:
            self.core.setCircularBufferMemoryFootprint(BUFFER_MB)
            if self.frames is None:
                self.core.startContinuousSequenceAcquisition(0)
            else:  # on overflow the camera goes on: the numbers say what is missing
                self.core.startSequenceAcquisition(self.frames, 0, False)
        except RuntimeError as error:
            msg = f"the camera can't be started ({' '.join(str(error).split())})"
            raise OSError(msg) from error
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the camera; what it has taken by then is written."""
        self.stop()
        self._thread.join()
        if error is None:
            self.finish()

    @property
    def ended(self) -> bool:
        """Whether no more frames come."""
        return self._thread.ident is not None and not self._thread.is_alive()

    def stop(self) -> None:
        """Tell the camera to take no more frames; those in its buffer are still written."""
        self._told.set()

    def finish(self) -> None:
        """Stop the camera, and wait until what it has taken by then is written.

        Raises
        ------
        OSError
            If the camera or the disk failed meanwhile.
        """
        self.stop()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _follow(self) -> None:
        """Write frames until the camera has ended and its buffer is empty."""
        expected, stopped = 0, False
        try:
            while True:
                if self._told.is_set() and not stopped:
                    stopped = True
                    self.core.stopSequenceAcquisition()
                # Asked in this order, or a frame that comes in between would stay behind.
                running = self.core.isSequenceRunning()
                if not self.core.getRemainingImageCount():
                    if not running:
                        break
                    time.sleep(LOOK_S)
                    continue
                try:
                    image, notes = self.core.popNextImageAndMD()
                except IndexError:  # a buffer that ran over was emptied meanwhile
                    continue
                number = int(notes["ImageNumber"])
                self.dropped += number - expected
                expected = number + 1
                self._write(number, np.asarray(image))
                self.written += 1
            if self.frames is not None and not stopped:
                self.dropped += self.frames - expected
        except Exception as error:  # of the camera's own library
            why = " ".join(str(error).split()) or type(error).__name__
            self._error = OSError(f"the camera stopped after {self.written} frames ({why})")
        finally:
            if self.core.isSequenceRunning():
                self.core.stopSequenceAcquisition()

    def _write(self, number: int, frame: NDArray[Any]) -> None:
        """Write a frame; its file has its name only when it is whole."""
        frame = grey(frame)
        if frame.ndim != 2:
            raise ValueError(colour_sentence("the camera"))
        path = self.folder / NAME.format(number)
        hidden = path.with_name(f".{path.name}")
        tifffile.imwrite(hidden, frame)
        hidden.replace(path)


def counts(name: str) -> bool:
    """Say whether a file is more than what systems leave in folders, such as ``.DS_Store``."""
    return not name.startswith(".") or name.startswith(".frame_")
