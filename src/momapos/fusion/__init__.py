"""From posed depth images to one upright cloud."""
