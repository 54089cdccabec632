"""The paper's actions on a formed hitch: what moves, and what stays."""
