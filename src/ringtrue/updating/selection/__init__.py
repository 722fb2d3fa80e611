"""The choice of parameters: from the cards of a deck to a few that explain a test."""
