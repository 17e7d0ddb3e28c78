"""The experiments of the paper: what is run (`plan`), how (`runner`), and what is made of it (`report`)."""
