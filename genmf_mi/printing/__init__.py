"""What comes off the printer: slices, beads of filament, and what they look like."""
