"""Time and memory of `project_pixels` where lights are missing in pixels, each of which has a factorisation of its own.

    python -m benchmarks.pixels_with_holes [--smoke]

64 lights, 16 functions, 3 channels, float32, from file to file, as in `benchmarks.scaling`: a share of all pairs of
pixel and light is NaN, anywhere. Every row is a fresh process, the better of two runs after one of a tile.
"""

import json
import subprocess
import sys

from benchmarks._smoke import parser
from benchmarks.scaling import LIGHTS, of_pixels, peak

SHARES = 0.0, 0.0001, 0.001, 0.01, 0.1, 0.5
PIXELS, SMOKE = 2**18, 2**9


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--share", type=float, help="of one row, which is printed as JSON")
    chosen = options.parse_args()
    if chosen.share is not None:
        print(json.dumps({**of_pixels(PIXELS, chosen.share), "peak_gigabytes": peak()}))
        return
    pixels = SMOKE if chosen.smoke else PIXELS
    print(f"{pixels} pixels\n\n| values missing | pixels that lack one | core µs a pixel | seconds | peak GB |")
    print("|---|---|---|---|---|")
    for share in SHARES:
        if chosen.smoke:
            one = {**of_pixels(pixels, share), "peak_gigabytes": peak()}
        else:
            command = [sys.executable, "-m", "benchmarks.pixels_with_holes", "--share", str(share)]
            one = json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout)
        cost = f"{1e6 * one['core_seconds'] / pixels:.2f} | {one['seconds']:.2f} | {one['peak_gigabytes']:.2f}"
        print(f"| {share:.2%} | {1 - (1 - share) ** LIGHTS:.1%} | {cost} |", flush=True)


if __name__ == "__main__":
    main()
