"""The contracts that every stage keeps; standard library only."""
