"""The finished kitchens that ship with momapos, and the furniture of boxes they are made of."""
