"""Who may take part in a run and do what in it: roles, their certificates or passwords, and the access control."""
