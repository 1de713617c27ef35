"""Names of the class numbers of ScanNet.

The 20 classes of the first benchmark use the numbers of NYU40; the 200 classes use ScanNet's own.
One number has different meanings in the two.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

ClassSet = Literal["scannet20", "scannet200"]

SCANNET20: Mapping[int, str] = {
    1: "wall", 2: "floor", 3: "cabinet", 4: "bed", 5: "chair", 6: "sofa", 7: "table", 8: "door",
    9: "window", 10: "bookshelf", 11: "picture", 12: "counter", 14: "desk", 16: "curtain",
    24: "refrigerator", 28: "shower curtain", 33: "toilet", 34: "sink", 36: "bathtub",
    39: "other furniture",
}  # fmt: skip

# Parts of rooms, furniture, appliances, and kitchen objects; other classes keep their numbers.
SCANNET200: Mapping[int, str] = {
    1: "wall", 2: "chair", 3: "floor", 4: "table", 5: "door", 6: "couch", 7: "cabinet",
    8: "shelf", 9: "desk", 10: "office chair", 11: "bed", 14: "sink", 15: "picture",
    16: "window", 18: "bookshelf", 21: "curtain", 22: "book", 23: "armchair",
    24: "coffee table", 26: "box", 27: "refrigerator", 28: "lamp", 29: "kitchen cabinet",
    31: "towel", 33: "tv", 34: "nightstand", 35: "counter", 36: "dresser", 38: "stool",
    40: "plant", 41: "ceiling", 44: "end table", 45: "dining table", 51: "tv stand",
    56: "trash can", 57: "closet", 59: "microwave", 62: "stove", 65: "bottle", 66: "bin",
    68: "bench", 70: "washing machine", 73: "basket", 74: "sofa chair", 75: "file cabinet",
    82: "paper towel dispenser", 84: "oven", 87: "rack", 88: "plate", 96: "radiator",
    97: "recycling bin", 98: "container", 99: "wardrobe", 100: "soap dispenser", 102: "bucket",
    104: "stand", 110: "clothes dryer", 116: "seat", 120: "column", 130: "cup",
    132: "storage bin", 134: "coffee maker", 136: "dishwasher", 138: "paper towel roll",
    139: "machine", 141: "windowsill", 145: "bar", 148: "toaster", 159: "kitchen counter",
    161: "doorframe", 165: "mini fridge", 177: "water cooler", 185: "tray", 191: "pillar",
    193: "ledge", 195: "toaster oven", 213: "furniture", 214: "cart", 221: "storage container",
    233: "crate", 276: "closet door", 323: "dish rack", 342: "range hood", 392: "water bottle",
    488: "water pitcher", 562: "bowl", 1156: "bathroom counter", 1164: "bathroom vanity",
    1165: "closet wall", 1169: "trash bin", 1173: "bathroom cabinet", 1176: "coffee kettle",
    1183: "storage organizer", 1184: "folded chair", 1189: "potted plant",
}  # fmt: skip


def class_set(ids: Iterable[int]) -> ClassSet:
    """Guess which classes numbers come from: the 20 if all are among them, else the 200."""
    return "scannet20" if set(ids) <= set(SCANNET20) else "scannet200"


def class_name(number: int, classes: ClassSet) -> str:
    """Name of a class, or "class 123" where it is not known here."""
    table = SCANNET20 if classes == "scannet20" else SCANNET200
    return table.get(number, f"class {number}")
