"""The studio: a study in the browser, on the machine of its user."""
