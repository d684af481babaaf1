"""Scenes that follow a recorded or a running session, and films: MP4 by ffmpeg, GIF by Pillow."""

import contextlib
import itertools
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Replica
from burrlab.common.check import check_positive, refuse
from burrlab.common.files import new_file
from burrlab.common.progress import Progress, reporter
from burrlab.effects.companion import Companion
from burrlab.effects.effects import Effects
from burrlab.session.player import Player, RecordingPlayer, TracePlayer
from burrlab.session.session import Session
from burrlab.session.trace import Trace
from burrlab.view.camera import approach_view
from burrlab.view.page_source import LiveSource, ReplaySource
from burrlab.view.scene import Scene, SceneWindow


class TraceView:
    """A scene that follows a player.

    Parameters
    ----------
    trace : Trace, TracePlayer or RecordingPlayer
    effects : Effects, optional
        Effects of the trace's initial bone, without a frame yet. Dust, blood and water are made here for the
        whole trace.
    slices : bool
        Show slices through the first burr's centre.
    progress : callable or True, optional
        Called with the fraction of the effects made, 0 to 1; True shows a bar.
    **options
        Options of the `Scene`; by default burrs are outlined.

    Attributes
    ----------
    player : TracePlayer or RecordingPlayer
    scene : Scene

    Raises
    ------
    TypeError
        If `trace` is none of these, or a recording with effects.
    """

    def __init__(
        self,
        trace: Trace | Player,
        *,
        effects: Effects | None = None,
        slices: bool = False,
        progress: Progress | None = None,
        **options: Any,
    ) -> None:
        self.player = trace if isinstance(trace, TracePlayer | RecordingPlayer) else TracePlayer(trace)
        self._replay, self.slices = ReplaySource(self.player, effects), slices
        if self._replay.past is not None:
            self._replay.past.make(progress=progress)
        settings = {"outline": True, "note": self._replay.note, **options}
        self._note = str(settings["note"])
        self.scene = Scene(self.player.bone, self._replay.radii, **settings)
        self.scene.look(approach_view(self.player.bone, self._replay.approach))
        self.go(self.player.time)

    def go(self, seconds: float, *, progress: Progress | None = None) -> int:
        """Shows a time of the trace [s], and says it; returns the number of blocks made anew. `progress` as
        for `TracePlayer.seek`. ValueError outside the trace."""
        self.scene.say(f"{self._note}\n{seconds:.2f} s".lstrip())
        return self._replay.show_in(
            self.scene, self._replay.go(seconds, progress=progress), slices=self.slices, curves=True
        )

    def frames(
        self,
        *,
        fps: float = 20.0,
        speed: float = 1.0,
        start: float = 0.0,
        stop: float | None = None,
        stereo: bool = False,
        progress: Progress | None = None,
    ) -> Iterator[NDArray[np.uint8]]:
        """Pictures for a film.

        Parameters
        ----------
        fps : float
            [1/s]
        speed : float
            The trace's time over the film's.
        start, stop : float
            Part of the trace [s]; default: all.
        stereo : bool
            Both eyes side by side.
        progress : callable or True, optional
            Called with the fraction done, from 0 to 1, after each frame; True shows a bar.

        Raises
        ------
        ValueError
            If fps or speed is not positive, or the part does not lie in the trace.
        """
        for name, value in (("fps", fps), ("speed", speed)):
            check_positive(name, value)
        end = self.player.duration if stop is None else stop
        refuse(
            not 0 <= start <= end <= self.player.duration + 1e-9,
            f"start and stop must lie from 0 to {self.player.duration:g}, got {start:g} and {end:g}",
        )
        count = int(np.floor((end - start) * fps / speed + 1e-9)) + 1
        report_progress = reporter(progress, "film")
        for k in range(count):
            self.go(min(start + k * speed / fps, self.player.duration))
            yield self.scene.stereo_picture() if stereo else self.scene.picture()
            report_progress((k + 1) / count)

    def close(self) -> None:
        """Frees window and memory."""
        self.scene.close()


class LiveView:
    """A scene that follows a session or a replica.

    The loop is never asked. The follower's copy of the bone tells which bricks changed, and the scene's own
    copy takes them over.

    Parameters
    ----------
    source : Session or Replica
        A replica must have been started, and nothing else may take its changes.
    effects : Companion, optional
        Dust, blood and water, drawn as they are at each step.
    slices : bool
        Show slices through the first burr's centre.
    **options
        Options of the `Scene`.

    Attributes
    ----------
    scene : Scene
    bone : VoxelBone
        The scene's copy.
    tick : int
        Ticks shown.

    Raises
    ------
    TypeError
        If the source is neither.
    """

    def __init__(
        self,
        source: Session | Replica,
        *,
        effects: Companion | None = None,
        slices: bool = False,
        **options: Any,
    ) -> None:
        self._live, self._source, self.slices = LiveSource(source, effects), source, slices
        self.bone, self.tick = self._live.bone, self._live.tick
        self.scene = Scene(self.bone, self._live.radii, **{"note": self._live.note, **options})

    def step(self) -> int:
        """Takes over the changes since the last step; returns the number of blocks made anew."""
        bricks = self._live.go(0.0)
        self.tick = self._live.tick
        return self._live.show_in(self.scene, bricks, slices=self.slices, curves=True)

    def run(self, *, rate: float = 20.0) -> None:
        """Shows the scene in its window, in the main thread, until the session ends or the window is closed.

        Parameters
        ----------
        rate : float
            Rate of the steps [1/s].

        Raises
        ------
        ValueError
            If the rate is not positive.
        """
        check_positive("rate", rate)
        next_at, ended = time.monotonic(), False
        with SceneWindow(self.scene) as window:
            while not ended:
                ended = self._source.wait(max(next_at - time.monotonic(), 0.0))
                next_at = max(next_at + 1 / rate, time.monotonic())
                self.step()
                if not window.turn(draw=True):
                    return

    def close(self) -> None:
        """Frees window and memory; the session goes on."""
        self.scene.close()


_MOST_FPS = {".mp4": 240, ".gif": 50}  # browsers show a GIF's frames for 20 ms or more


def write_video(
    path: str | os.PathLike[str], frames: Iterable[NDArray[np.uint8]], *, fps: float = 20.0
) -> int:
    """Writes pictures as a film, by the file's ending: .mp4 (H.264) or .gif.

    Parameters
    ----------
    path : path-like
    frames : iterable of ndarray, shape (height, width, 3), uint8
        All of one size. An MP4 takes them one by one and need not fit into memory; a GIF keeps them all.
    fps : float
        Frames a second [1/s], from 1 to 240, or to 50 for GIF, which counts in 0.01 s.

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    ValueError
        If the ending is another, fps is out of range, there is no frame, or they differ in size.
    OSError
        If there is no ffmpeg for an MP4, or it fails; no file is left then.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> write_video(folder.name + "/film.gif", (np.full((48, 64, 3), shade, np.uint8) for shade in (0, 128, 255)))
    3
    >>> folder.cleanup()
    """
    file = Path(path)
    check_film(file, fps)
    with new_file(file, file.suffix) as part:
        return (_write_mp4 if file.suffix.lower() == ".mp4" else _write_gif)(part, _checked(frames), fps)


def check_film(file: Path, fps: float) -> None:
    """ValueError unless the file's ending and the frames a second are those of a film."""
    kind = file.suffix.lower()
    refuse(kind not in _MOST_FPS, f"a film must end in .mp4 or .gif, got {file.name}")
    refuse(
        not 1 <= fps <= _MOST_FPS[kind], f"fps must be from 1 to {_MOST_FPS[kind]} for {kind}, got {fps:g}"
    )


def ffmpeg() -> str:
    """The program ffmpeg: the system's, else that of the Python package imageio-ffmpeg.

    Raises
    ------
    OSError
        If there is neither.
    """
    if program := shutil.which("ffmpeg"):
        return program
    with contextlib.suppress(ImportError, RuntimeError):
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    raise OSError(
        "an MP4 needs ffmpeg: apt-get install ffmpeg, or pip install imageio-ffmpeg; a film that ends in "
        ".gif needs neither"
    )


def _checked(frames: Iterable[NDArray[np.uint8]]) -> Iterator[NDArray[np.uint8]]:
    """The frames; ValueError unless there is one, and all are pictures of one size."""
    first = None
    for frame in frames:
        refuse(
            frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8,
            f"a frame must be uint8 of the shape (height, width, 3), got {frame.dtype} {frame.shape}",
        )
        first = frame.shape if first is None else first
        refuse(frame.shape != first, f"frames must have one size, got {first} and {frame.shape}")
        yield frame
    refuse(first is None, "a film needs at least one frame")


def _write_mp4(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> int:
    first, count = next(frames), 0
    height, width = (n // 2 * 2 for n in first.shape[:2])  # H.264 takes even sizes only
    command = [
        ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", f"{fps:g}", "-i", "-", "-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18",
        "-movflags", "+faststart", str(path),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as messages:
        # a broken pipe is explained by the exit status and the last message
        with contextlib.suppress(BrokenPipeError), subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=messages
        ) as encoder:  # fmt: skip
            assert encoder.stdin is not None
            try:
                for frame in itertools.chain([first], frames):
                    encoder.stdin.write(np.ascontiguousarray(frame[:height, :width]).data)
                    count += 1
            except BaseException:
                encoder.kill()
                raise
        if encoder.returncode:
            messages.seek(0)
            words = messages.read().decode(errors="replace").strip().splitlines()
            raise OSError(f"ffmpeg failed: {words[-1] if words else encoder.returncode}")
    return count


def _write_gif(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> int:
    from PIL import Image

    # the median cut would spend its colours on the bone, and a nerve or its name in the legend would turn
    # grey
    pictures = [Image.fromarray(frame).quantize(256, Image.Quantize.MAXCOVERAGE) for frame in frames]
    # whole hundredths of a second; some frames have one more, so that the film keeps its length
    durations = np.diff(10 * np.rint(100 / fps * np.arange(len(pictures) + 1)).astype(int)).tolist()  # [ms]
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], loop=0,
        duration=durations if len(durations) > 1 else durations[0],
    )  # fmt: skip
    return len(pictures)
