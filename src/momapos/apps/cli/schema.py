"""momapos schema: print the JSON Schema of a file format."""

from __future__ import annotations

import json
from typing import Annotated, Optional

from tyro.conf import Positional, arg

from momapos.core import say, unknown_name

from .options import Flag


def schema(
    name: Annotated[Positional[Optional[str]], arg(metavar="NAME", help_behavior_hint="")] = None,  # noqa: UP045
    /,
    *,
    fields: Flag = False,
) -> int:
    """Print the JSON Schema of a file format, or list the formats.

    Exit status: 0 printed; 2 unknown format.

    Args:
        name: The format; without one, all are listed.
        fields: Print the members as tables in Markdown.
    """
    from momapos.apps.schemas import SCHEMAS, field_list, schema_of

    if name is not None and name not in SCHEMAS:
        raise unknown_name("format", name, SCHEMAS, "momapos")
    if fields:
        say(field_list(tuple(SCHEMAS) if name is None else (name,)), end="")
    elif name is None:
        for one, (title, _) in SCHEMAS.items():
            say(f"{one:<10} {title}")
    else:
        say(json.dumps(schema_of(name), indent=1))
    return 0
