"""Plans in flight: the clock, aborts, lost drones, new goals, corrections, streams to fleets."""
