"""Making arms from files: reading, the short list of additions to the model, and the report of both."""
