"""What several tests share: plans that are solved once, second opinions, writers of files."""
