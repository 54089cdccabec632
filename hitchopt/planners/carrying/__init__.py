"""Holding and carrying of objects: polygons around them, holds, and moves of hitches with one."""
