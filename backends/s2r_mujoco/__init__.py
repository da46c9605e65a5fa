"""A robot from its MuJoCo model, its trained policy and its deploy file: ``robot.toml`` as a backend.

A module imports only from its own line and the lines below it:

    backend                      the interface to s2r: a test in, a trace out
    preflight, new, pictures     do the files fit; the first robot file; tiles and videos
    running                      rollouts of tests, with the user's own code
    robot                        what the files say together: channels, parameters, files, hash
    parameters                   the parameters of a test, with units and ranges
    channels, failure            from the record of a rollout to its trace
    rollout                      start, control ticks, physics steps, record
    observation, drive, start    what the policy reads, what its actions do, the state at t = 0
    plan, law                    robot file, deploy file and model put together
    joints                       the order of a policy's joints in the model
    description, model           the robot file; the MuJoCo model before it is compiled
    model_files, toml            the files that an XML includes and loads; files in TOML, checked
    deploy/                      deploy files of the field, each read into one record
"""
