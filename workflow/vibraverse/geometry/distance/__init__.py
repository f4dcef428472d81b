"""How far, how near and what crosses: queries on triangle surfaces."""
