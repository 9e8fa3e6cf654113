"""Video files and animated GIFs of images, and labelled grids of images."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from PIL import Image

from oes.episode import Pixels
from oes.viz.overlay import INK


def sheet(rows: Sequence[tuple[str, Sequence[Pixels]]]) -> Pixels:
    """Stack rows of equal tiles H W 3, each after a dark field with the row's name."""
    return np.vstack(
        [np.hstack([_name(text, *tiles[0].shape[:2]), *tiles]) for text, tiles in rows]
    )


def write_video(images: Iterable[Pixels], path: Path, fps: int) -> None:
    """Write images H W 3 of one size (even H and W) as H.264 in MP4; equal images, equal bytes."""
    with av.open(str(path), "w", options={"fflags": "+bitexact"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(fps))
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "26", "preset": "veryfast", "threads": "1", "flags": "+bitexact"}
        # Without mbtree=0 the bytes of equal images vary from run to run.
        stream.options |= {"x264-params": "mbtree=0"}
        for image_i, pixels in enumerate(images):
            if image_i == 0:
                stream.height, stream.width = pixels.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())


def write_gif(shots: Sequence[tuple[Pixels, float]], path: Path) -> None:
    """Write an endless GIF of images, each shown for its number of seconds."""
    frames = [
        Image.fromarray(pixels).quantize(128, dither=Image.Dither.NONE) for pixels, _ in shots
    ]
    times_ms = [round(seconds * 1000) for _, seconds in shots]
    first, *rest = frames
    first.save(path, save_all=True, append_images=rest, duration=times_ms, loop=0, optimize=False)


def _name(text: str, height: int, width: int) -> Pixels:
    """A field half as wide as a tile, one word of the text a line."""
    field = np.zeros((height, width // 2, 3), dtype=np.uint8)
    for line_i, word in enumerate(text.split()):
        place = (height // 32, (line_i + 1) * height // 9)
        cv2.putText(field, word, place, cv2.FONT_HERSHEY_SIMPLEX, height / 350, INK, 1, cv2.LINE_AA)
    return field
