"""Models of demonstrations, compared."""
