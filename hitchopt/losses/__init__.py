"""The loss of a robot in flight: its certificate, and plans from the loss on."""
