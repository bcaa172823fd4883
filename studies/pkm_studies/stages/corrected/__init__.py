"""Parameters and effects estimated together as the section `corrected`."""
