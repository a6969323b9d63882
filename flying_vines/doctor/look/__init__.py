"""Facts about this computer, from files, sockets and the clock. `checks/` judges them."""
