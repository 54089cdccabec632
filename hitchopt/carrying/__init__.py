"""Objects that hitches hold and carry: polygons around them, holds, moves, and the steps."""
