"""Rank the objects of a scene by their importance for opening the fridge."""

import momapos

found = momapos.rank(momapos.load_scene("kitchen_small"), "fridge", seed=0)
print(f"{found.target}: {len(found.selected())} of {len(found.names)} objects are important")
for name, score, relation in zip(found.names, found.scores, found.relations, strict=True):
    print(f"{score:6.3f}  {name:<14} {relation}")
print("a lower threshold adds", *found.selected(0.3)[len(found.selected()) :])
