"""The experiments of the paper: the jobs (`plan`), their results (`results`), and the report on them (`report`)."""
