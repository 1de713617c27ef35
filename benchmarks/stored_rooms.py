"""Write the contents of the rooms of `paper-sim` that the package stores.

The rooms of the default seed are drawn, or taken from the cache. Run it after a change of the rooms
(raise `REVISION` in `dining_rooms`), or with another version of scene-synthesizer:

    python -m benchmarks.stored_rooms
"""

from __future__ import annotations

import argparse
import json

from momapos.apps.bench.dining_rooms import CONTENTS, DEFAULT_SEED, STORED, drawn_by, drawn_room
from momapos.apps.bench.suites import ROOMS


def main() -> None:
    """Write one room to a line."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    rooms = [(drawn_room(DEFAULT_SEED, k) / CONTENTS).read_text() for k in range(ROOMS)]
    lines = ",\n".join(json.dumps(json.loads(room), separators=(",", ":")) for room in rooms)
    STORED.write_text(f'{{"versions": {json.dumps(drawn_by())}, "rooms": [\n{lines}\n]}}\n')
    print(f"{STORED}: {len(rooms)} rooms, {STORED.stat().st_size} bytes")


if __name__ == "__main__":
    main()
