"""What every stage keeps; standard library only."""
