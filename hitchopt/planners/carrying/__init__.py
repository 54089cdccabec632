"""Planners that hold and carry objects: polygons around them, holds, and moves."""
