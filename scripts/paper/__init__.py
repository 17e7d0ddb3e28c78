"""The experiments of the paper: what is run (`plan`), what comes of it (`results`) and is made of it (`report`)."""
