"""Sprite sheets: small pictures side by side in one file, so that a page of ten thousand loads a hundred files."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from itertools import islice

#: Pictures across and down, and their side in pixels.
ACROSS, SIDE_PX = 10, 96
_QUALITY = 82


def sheets(pictures: Iterable[bytes]) -> Iterator[bytes]:
    """Yield sheets (WebP) of ``ACROSS``² pictures, row by row; each picture is the content of an image file.

    The last sheet is empty where there are no more. Raises :class:`ValueError`, with the place of the picture, for one
    that cannot be read.
    """
    from PIL import Image

    left = enumerate(pictures)
    while some := list(islice(left, ACROSS**2)):
        sheet = Image.new("RGBA", (ACROSS * SIDE_PX, ACROSS * SIDE_PX))
        for place, content in some:
            try:
                picture = Image.open(io.BytesIO(content)).convert("RGBA")
            except OSError as error:
                raise ValueError(place) from error
            down, across = divmod(place % ACROSS**2, ACROSS)
            sheet.paste(picture.resize((SIDE_PX, SIDE_PX)), (across * SIDE_PX, down * SIDE_PX))
        file = io.BytesIO()
        sheet.save(file, format="WEBP", quality=_QUALITY, method=4)
        yield file.getvalue()
