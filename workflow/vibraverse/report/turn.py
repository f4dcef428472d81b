"""Small pictures of an object: its views side by side in one file, and a thumbnail."""

from __future__ import annotations

import io

from PIL import Image, WebPImagePlugin

#: Frames of a turn at most, in rows of this many, and the size of each in pixels.
FRAMES, ACROSS, SIZE_PX = 6, 3, 256
THUMBNAIL_PX = 96
_QUALITY = 82


def turn(pictures: list[bytes]) -> tuple[bytes, int]:
    """Return up to :data:`FRAMES` of some PNG files, evenly chosen, as one WebP file; and their number."""
    count = min(FRAMES, len(pictures))
    chosen = [pictures[number * len(pictures) // count] for number in range(count)]
    rows = -(-count // ACROSS)
    sheet = Image.new("RGB", (ACROSS * SIZE_PX, rows * SIZE_PX))
    for number, picture in enumerate(chosen):
        place = (number % ACROSS * SIZE_PX, number // ACROSS * SIZE_PX)
        sheet.paste(_scaled(picture, SIZE_PX), place)
    return _webp(sheet), count


def thumbnail(picture: bytes) -> bytes:
    """Return a PNG file as a small WebP file."""
    return _webp(_scaled(picture, THUMBNAIL_PX))


def blank() -> bytes:
    """Return the thumbnail of an object that has no picture: one transparent pixel."""
    return _webp(Image.new("RGBA", (1, 1)))


def _scaled(picture: bytes, size_px: int) -> Image.Image:
    with Image.open(io.BytesIO(picture)) as opened:
        return opened.convert("RGB").resize((size_px, size_px), Image.Resampling.LANCZOS)


def _webp(picture: Image.Image) -> bytes:
    file = io.BytesIO()
    picture.save(file, format=WebPImagePlugin.WebPImageFile.format, quality=_QUALITY, method=6)
    return file.getvalue()
