"""What is compiled: springs, contact, limits and readings of one world, and the tables that they need."""
