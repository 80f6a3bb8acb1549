"""Pictures of floor plans: PNG, JPEG or a page of a PDF file, converted to PNG of bounded size, and rectified."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.values.safe_files import read_small, whole_file

MAX_PICTURE_BYTES = 64 * 1024**2
# A scan of A0 at 300 dpi has 139 million pixels; larger claims are mistakes or attacks.
_MAX_PIXELS = 150_000_000
# Longest side of a stored picture: a browser draws it, and 100 m then have 2.5 cm per pixel.
_MAX_SIDE = 4000
_SIGNATURES = {b"\x89PNG": "PNG", b"\xff\xd8\xff": "JPEG", b"%PDF": "PDF"}


def convert_picture(source: Path, page: int, target: Path) -> dict[str, Any]:
    """Convert a PNG, JPEG or page of a PDF file (from 1) to a PNG file of bounded size, and return its size."""
    content = read_small(source, MAX_PICTURE_BYTES)
    kind = next((kind for begin, kind in _SIGNATURES.items() if content.startswith(begin)), None)
    if kind is None:
        raise ValueError("the picture is neither PNG, JPEG nor PDF; save it as one of them")
    return _save(_pdf_page(content, page) if kind == "PDF" else _opened(content), target)


def rectify(path: Path, corners: Sequence[Sequence[float]]) -> dict[str, Any]:
    """Turn the quadrilateral of four corners (pixels, clockwise from top left) into a whole picture; return its size.

    The file is replaced. The result is as wide and as high as the longer of the two opposite sides, at most 4000
    pixels. ValueError if the corners are not a convex quadrilateral.
    """
    from PIL import Image

    quad = np.array(corners, dtype=float)
    if quad.shape != (4, 2) or not np.isfinite(quad).all():
        raise ValueError(f"corners must be four points, got {str(corners)[:80]}; click the four corners")
    sides = np.roll(quad, -1, axis=0) - quad
    turns = sides[:, 0] * np.roll(sides[:, 1], -1) - sides[:, 1] * np.roll(sides[:, 0], -1)
    if not ((turns > 1).all() or (turns < -1).all()):
        raise ValueError("the four corners must go round the plan without crossing; click them again, in order")
    length = np.linalg.norm(sides, axis=1)
    width, height = (int(min(max(length[k], length[k + 2], 1), _MAX_SIDE)) for k in (0, 1))
    picture = _opened(read_small(path, MAX_PICTURE_BYTES))
    # eight coefficients of the projective map from the rectangle to the quadrilateral
    target = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=float)
    rows = [
        row
        for (x, y), (u, v) in zip(target, quad, strict=True)
        for row in ([x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y])
    ]
    coefficients = np.linalg.solve(np.array(rows), quad.ravel())
    data = coefficients.tolist()
    made = picture.transform((width, height), Image.Transform.PERSPECTIVE, data, Image.Resampling.BICUBIC)
    return _save(made, path)


def _opened(content: bytes) -> Any:
    """Return a picture in RGB; ValueError if it is damaged or has too many pixels."""
    from PIL import Image, ImageOps

    try:
        picture = Image.open(io.BytesIO(content), formats=("PNG", "JPEG"))
        if picture.width * picture.height > _MAX_PIXELS:
            raise ValueError(f"{picture.width} x {picture.height} pixels are more than {_MAX_PIXELS}: reduce it")
        picture.draft("RGB", (_MAX_SIDE, _MAX_SIDE))
        return ImageOps.exif_transpose(picture).convert("RGB")
    except Exception as error:  # Pillow raises many kinds for damaged files
        raise ValueError(f"the picture cannot be used ({error}); save it again, smaller") from None


def _pdf_page(content: bytes, page: int) -> Any:
    try:
        import pypdfium2  # pyright: ignore[reportMissingImports]  (optional)
    except ImportError:
        raise ValueError(
            'pages of PDF files need pypdfium2: pip install "pdr_filter[app]"; or save the page as PNG'
        ) from None
    try:
        document = pypdfium2.PdfDocument(content)
        if not 1 <= page <= len(document):
            raise ValueError(f"there is no page {page}: the file has {len(document)}")
        sheet = document[page - 1]
        return sheet.render(scale=_MAX_SIDE / max(*sheet.get_size(), 1)).to_pil().convert("RGB")
    except Exception as error:  # whatever a damaged file provokes
        raise ValueError(f"the PDF file cannot be used ({error}); save the page as PNG") from None


def _save(picture: Any, target: Path) -> dict[str, Any]:
    picture.thumbnail((_MAX_SIDE, _MAX_SIDE))
    with whole_file(target) as file:
        picture.save(file, "PNG")
    return {"width": picture.width, "height": picture.height}
