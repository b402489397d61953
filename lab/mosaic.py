"""Composes a picture of any size from others, row by row, for encoding very large pictures:

    python lab/mosaic.py WIDTHxHEIGHT OUT.png PICTURE...

Needs Pillow. Pictures are cropped at the right and the lower border, and repeated when all have been used.
"""

import itertools
import sys

from PIL import Image

Image.MAX_IMAGE_PIXELS = None


def main() -> None:
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    size, out, *pictures = sys.argv[1:]
    try:
        width, height = map(int, size.split("x"))
    except ValueError:
        sys.exit(f"mosaic.py: {size!r} is no size; 16384x10825 is one")
    mosaic = Image.new("RGB", (width, height))
    rest = itertools.cycle(pictures)
    top = 0
    while top < height:
        left, lowest = 0, height
        while left < width:
            with Image.open(next(rest)) as picture:
                mosaic.paste(picture.convert("RGB"), (left, top))
                left += picture.width
                lowest = min(lowest, top + picture.height)
        # The next row starts below the shortest picture of this one and covers the others.
        top = lowest
    mosaic.save(out, compress_level=1)


if __name__ == "__main__":
    main()
