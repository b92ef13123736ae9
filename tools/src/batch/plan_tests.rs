//! Plans and their mistakes.

use super::*;

fn plan(text: &str) -> Result<Plan> {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["a.bvol", "b.bvol", "c.raw"] {
        std::fs::write(folder.path().join(name), b"x").expect("written");
    }
    let path = folder.path().join("job.toml");
    std::fs::write(&path, text).expect("written");
    Plan::read(&path)
}

#[test]
fn lists_are_multiplied_and_names_filled_in() {
    let plan = plan(
        "[[task]]\nop = \"mesh\"\ninput = [\"a.bvol\", \"b.bvol\"]\noutput = \"{stem}/{iso}.ply\"\n\
         iso = [1, -2.5]\nnormals = true\nkeys = false\nseed = [[\"1,2,3\", \"4,5,6\"]]\n\
         [[task]]\nop = \"check\"\ninput = \"a/*.ply\"\n",
    )
    .expect("a good plan");
    let outputs: Vec<_> = plan
        .tasks
        .iter()
        .filter_map(|t| t.output.as_ref())
        .collect();
    let end = |p: &PathBuf| p.strip_prefix(&plan.out).expect("below").to_path_buf();
    assert_eq!(
        outputs.into_iter().map(end).collect::<Vec<_>>(),
        ["a/1.ply", "a/-2.5.ply", "b/1.ply", "b/-2.5.ply"].map(PathBuf::from)
    );
    let line = plan.tasks[1].words(Path::new("w")).join(" ");
    assert!(
        line.ends_with("a.bvol w/-2.5.ply --iso=-2.5 --normals --seed=1,2,3 --seed=4,5,6"),
        "{line}"
    );
    // What an earlier task makes is an input like a file, and is waited for.
    assert_eq!(plan.tasks.len(), 6);
    assert_eq!(
        (&plan.tasks[4].after[..], &plan.tasks[5].after[..]),
        (&[1][..], &[0][..])
    );
}

#[test]
fn mistakes_are_said_with_their_line() {
    let mesh = "[[task]]\nop = \"mesh\"\ninput = \"a.bvol\"\n";
    for (text, line, part) in [
        (String::new(), None, "no task"),
        ("x = 1\n".into(), Some(1), "unknown field `x`"),
        ("\n[[task]]\nop = 3\n".into(), Some(2), "`op` = 3"),
        ("[[task]]\nop = \"demo\"\n".into(), Some(1), "use one of"),
        (
            "[[task]]\nop = \"mesh\"\noutput = \"x\"\n".into(),
            Some(1),
            "no `input`",
        ),
        (mesh.into(), Some(1), "no `output`"),
        (
            format!("{mesh}output = \"{{iso}}.ply\"\n"),
            Some(1),
            "has no `iso`",
        ),
        (
            format!("{mesh}output = \"../x.ply\"\n"),
            Some(1),
            "inside of the folder",
        ),
        (
            format!("{mesh}output = \"x.ply\"\nisos = 1\n"),
            Some(1),
            "no such option",
        ),
        (
            format!("{mesh}output = \"x.ply\"\nthreads = 1\n"),
            Some(1),
            "whole batch",
        ),
        (
            format!("{mesh}output = \"x.ply\"\niso = []\n"),
            Some(1),
            "empty list",
        ),
        (
            format!("{mesh}output = \"x.ply\"\niso = \"much\"\n"),
            Some(1),
            "much",
        ),
        (
            format!("{mesh}output = \"x.ply\"\niso = [1, 2]\n"),
            Some(1),
            "both write",
        ),
        (
            format!("{mesh}output = \"x.ply\"\nmem = \"lots\"\n"),
            Some(1),
            "mem",
        ),
        (
            "[[task]]\nop = \"info\"\ninput = \"none.bvol\"\n".into(),
            Some(1),
            "there is no file",
        ),
        (
            "[[task]]\nop = \"info\"\ninput = \"*.none\"\n".into(),
            Some(1),
            "no such file",
        ),
        (
            "[[task]]\nop = \"info\"\ninput = \"a.bvol\"\noutput = \"x\"\n".into(),
            Some(1),
            "writes no file",
        ),
        (
            format!("{mesh}output = \"x.ply\"\ntiles = 0\n"),
            Some(1),
            "tiles = 0",
        ),
        (
            format!("{mesh}output = \"x.ply\"\ntiles = 2\nmeasure = true\n"),
            Some(1),
            "--measure",
        ),
        (
            format!("{mesh}output = \"x.ply\"\npart = \"1/2\"\n"),
            Some(1),
            "tiles = N",
        ),
        (
            "[[task]]\nop = \"info\"\ninput = \"a.bvol\"\ntiles = 2\n".into(),
            Some(1),
            "only",
        ),
        ("[[task]\n".into(), Some(1), ""),
    ] {
        let error = plan(&text).expect_err(&text).to_string();
        let place = line.map_or("job.toml: ".to_string(), |l| format!("job.toml:{l}: "));
        assert!(
            error.contains(&place) && error.contains(part),
            "{text}: {error}"
        );
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn a_mesh_in_tiles_is_a_task_for_each_and_one_that_joins_them() {
    let plan = plan(
        "[[task]]\nop = \"info\"\ninput = \"b.bvol\"\n[[task]]\nop = \"mesh\"\ninput = \"a.bvol\"\n\
         output = \"x/{iso}.ply\"\niso = [1, 2]\nallow-empty = true\ntiles = 3\n\
         [[task]]\nop = \"check\"\ninput = \"x/2.ply\"\n",
    )
    .expect("a good plan");
    let ops: Vec<_> = plan.tasks.iter().map(|t| t.op.as_str()).collect();
    let (m, j) = ("mesh", "join");
    assert_eq!(ops, ["info", m, m, m, j, m, m, m, j, "check"]);
    let join = &plan.tasks[8];
    assert_eq!((&join.after[..], join.part_for), (&[5, 6, 7][..], None));
    assert!(join.input.ends_with("a.bvol") && plan.tasks[9].after == [8]);
    let line = join.words(Path::new("w"));
    assert_eq!(line[..2], ["join", "w/2.ply"]);
    assert_eq!(line.last().map(String::as_str), Some("--allow-empty"));
    for (n, part) in plan.tasks[5..8].iter().enumerate() {
        let output = part.output.as_ref().expect("writes its part");
        assert_eq!(line[2 + n], output.to_string_lossy());
        assert_eq!(part.part_for, Some(8));
        let last = part.line().pop().expect("words");
        assert_eq!(last, format!("--part={}/3", n + 1));
        assert_ne!(part.key, plan.tasks[1 + n].key);
    }
}
