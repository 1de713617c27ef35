"""What the paper prints of its four tasks, to stand beside ours."""

from __future__ import annotations

from momapos.bench.tables import Cell, Table

PRINTED = (
    ("grasp apple", "MoMa-Pos", "13.5 +- 2.0", "3.2 +- 1.2", 100),
    ("grasp apple", "Habitat", "17.3 +- 0.2", "3.0 +- 0.0", 100),
    ("grasp apple", "M3*", "17.8 +- 2.3", "3.2 +- 1.1", 100),
    ("grasp apple", "Reuleaux", "19.2 +- 4.3", "3.6 +- 1.6", 100),
    ("grasp cup", "MoMa-Pos", "13.2 +- 2.4", "3.5 +- 1.4", 100),
    ("grasp cup", "Habitat", "16.9 +- 2.7", "3.2 +- 0.0", 100),
    ("grasp cup", "M3*", "17.3 +- 3.2", "3.3 +- 0.1", 100),
    ("grasp cup", "Reuleaux", "18.7 +- 3.9", "3.7 +- 1.1", 100),
    ("open fridge", "MoMa-Pos", "17.4 +- 2.3", "2.3 +- 0.1", 100),
    ("open fridge", "Habitat", "15.7 +- 1.4", "2.2 +- 0.0", 18),
    ("open fridge", "M3*", "18.2 +- 8.4", "2.2 +- 0.1", 26),
    ("open fridge", "Reuleaux", "17.7 +- 2.7", "2.5 +- 0.1", 70),
    ("open microwave", "MoMa-Pos", "17.2 +- 1.0", "3.7 +- 1.6", 100),
    ("open microwave", "Habitat", "14.4 +- 0.4", "3.2 +- 0.0", 22),
    ("open microwave", "M3*", "17.4 +- 1.4", "3.5 +- 0.0", 44),
    ("open microwave", "Reuleaux", "18.0 +- 2.0", "3.6 +- 1.4", 82),
)
"""Task, method, time [s], driving length [m], successes [%]: the main table of Shao et al."""


def printed_table() -> Table:
    """The paper's numbers as a table."""
    lines = tuple(
        (Cell(task), Cell(method), Cell(f"{seconds} s"), Cell(f"{way} m"), Cell(f"{percent} %"))
        for task, method, seconds, way, percent in PRINTED
    )
    note = (
        "On the real robot. Their time holds perception and modeling, and theirs are other starts: "
        "compare methods within a table, not numbers between them."
    )
    columns = ("task", "method, as printed", "time", "driving", "success")
    return Table("As printed in the paper (Shao et al.)", columns, lines, note)
