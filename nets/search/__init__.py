"""Search for the best member of Tab. 2's family: Optuna chooses, :mod:`nets.training` judges.

``space`` is what is varied, ``config`` what stays, ``objective`` one trial,
``study`` the trials of all machines and how dead ones are noticed, ``worker``
the loop of one process, ``processes`` several of them, ``report`` and
``figures`` what a person reads.
"""
