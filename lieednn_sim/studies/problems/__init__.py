"""Published planning problems, and how planners perform on them."""
