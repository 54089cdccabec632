"""Holding and carrying of objects: polygons around them, and motions of hitches that hold one."""
