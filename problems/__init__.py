"""Problem files, and scripts that write some of them."""
