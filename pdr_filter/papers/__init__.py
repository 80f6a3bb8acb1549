"""What only one published system uses, a folder for each."""
