//! Simulated data set as a folder: images, project file, truth, and simulated observations.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{
    OutputFolder, camera_document, poses_document, write_centers, write_features, write_jpeg,
    write_png,
};
use crate::error::{Error, Result};
use crate::image::RawImage;
use crate::model::{FramePose, InternalParameters, Subset};
use crate::simulation::{
    Content, DataSet, Progress, Settings, Shot, Simulated, Target, TrueCenter, TrueFeature,
    simulate,
};

/// Simulates a data set and stages it:
///
/// - `whites/`, `devignetting.png`, `calibration/`, `evaluation/`, `translation/`: the images, PNG or JPEG;
/// - `project.toml`: the project file that a user would write for them; `simulation.toml`: the settings;
/// - `truth/`: camera, paraxial data of a real main lens, internal parameters, the shape of the board, centres with
///   lens types, and for every subset poses and features with the fraction of their light that is `visible`;
/// - `observed/`, if there are calibration boards: the observations with noise, and a project file
///   of its own for `calibrate`.
pub fn stage_data_set(
    output: &mut OutputFolder,
    settings: &Settings,
    poses: Option<Vec<FramePose>>,
    progress: &dyn Progress,
) -> Result<Simulated> {
    let text = settings.to_toml()?;
    output.stage("simulation.toml", |out| out.write_all(text.as_bytes()))?;
    let simulated = simulate(settings, poses, progress, &mut |content, shot, image| {
        output.stage(image_name(content, shot), |out| write_image(out, shot, &image))
    })?;
    let project = project_text(settings, &simulated.data_set);
    output.stage("project.toml", |out| out.write_all(project.as_bytes()))?;
    stage_truth(output, &settings.target, &simulated)?;
    if !simulated.observed.features.is_empty() {
        stage_observed(output, settings, &simulated)?;
    }
    Ok(simulated)
}

/// Returns the file name of an image in the folder of its data set.
#[must_use]
pub fn image_name(content: Content, shot: &Shot) -> String {
    let name = match content {
        Content::White(_) => {
            format!("whites/white-{}-n-{:.2}", shot.number, shot.stated_f_number)
        }
        Content::Devignetting => "devignetting".to_owned(),
        Content::Board(subset, frame) => format!("{0}/{0}-{frame:02}", subset.name()),
    };
    let extension = if shot.imaging.jpeg_quality.is_some() { "jpg" } else { "png" };
    format!("{name}.{extension}")
}

/// Returns true if a folder contains a data set, which a user may have edited.
#[must_use]
pub fn is_data_set(folder: &Path) -> bool {
    ["project.toml", "simulation.toml"].iter().any(|name| folder.join(name).exists())
}

/// Folders of a data set, with the prefixes of the names of their images.
const IMAGE_FOLDERS: [(&str, &str); 4] = [
    ("whites", "white-"),
    ("calibration", "calibration-"),
    ("evaluation", "evaluation-"),
    ("translation", "translation-"),
];

/// Removes files of an earlier data set in the folder that are not among the `written` files: images of further boards would be
/// taken for images of the new one. Files with other names stay.
pub fn remove_older_data(folder: &Path, written: &[PathBuf]) {
    let is_image = |path: &Path| path.extension().is_some_and(|e| e == "png" || e == "jpg");
    let mut older: Vec<PathBuf> = Vec::new();
    for (name, begin) in IMAGE_FOLDERS {
        let entries = fs::read_dir(folder.join(name)).into_iter().flatten().flatten();
        let begins = |path: &Path| {
            path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(begin))
        };
        older.extend(entries.map(|e| e.path()).filter(|path| begins(path) && is_image(path)));
    }
    let subsets = Subset::ALL.map(|subset| folder.join("truth").join(subset.name()));
    let truth = subsets.iter().flat_map(|f| ["poses.json", "features.csv"].map(|n| f.join(n)));
    older.extend(truth);
    let observed = ["centers.csv", "features.csv", "project.toml"];
    older.extend(observed.map(|name| folder.join("observed").join(name)));
    let single = ["devignetting.png", "devignetting.jpg", "truth/main_lens.toml"];
    older.extend(single.map(|name| folder.join(name)));
    for path in older.iter().filter(|path| !written.contains(path)) {
        let _ = fs::remove_file(path);
    }
    let folders = IMAGE_FOLDERS.map(|(name, _)| folder.join(name));
    for empty in folders.into_iter().chain(subsets).chain([folder.join("observed")]) {
        // A folder that is not empty stays.
        let _ = fs::remove_dir(empty);
    }
}

fn write_image(out: &mut dyn Write, shot: &Shot, image: &RawImage) -> io::Result<()> {
    match shot.imaging.jpeg_quality {
        Some(quality) => write_jpeg(out, image, quality),
        None => write_png(out, image),
    }
}

fn stage_truth(output: &mut OutputFolder, target: &Target, simulated: &Simulated) -> Result<()> {
    let Simulated { data_set, truth, .. } = simulated;
    output.stage_json("truth/camera.json", &camera_document(&truth.camera, None))?;
    output.stage("truth/centers.csv", |out| write_true_centers(out, &truth.centers))?;
    let internal = internal_text(&truth.internal)?;
    output.stage("truth/internal_parameters.toml", |out| out.write_all(internal.as_bytes()))?;
    if let Some(figures) = &truth.main_lens {
        let figures = toml::to_string(figures).map_err(|e| {
            Error::invalid(format!("the figures of the lens cannot be written: {e}"))
        })?;
        let text = format!(
            "# The main lens by rays close to its axis, and by all light; see docs/simulation.md.\n{figures}"
        );
        output.stage("truth/main_lens.toml", |out| out.write_all(text.as_bytes()))?;
    }
    let shape = shape_text(target);
    output.stage("truth/board.toml", |out| out.write_all(shape.as_bytes()))?;
    let boards = Subset::ALL.into_iter().zip(&data_set.subsets).zip(&truth.features);
    for ((subset, boards), features) in boards.filter(|((_, boards), _)| !boards.is_empty()) {
        let folder = PathBuf::from("truth").join(subset.name());
        let poses: Vec<_> = boards.iter().map(|&(pose, _)| pose).collect();
        output.stage_json(
            folder.join("poses.json"),
            &poses_document(&poses, None, &BTreeSet::new()),
        )?;
        output.stage(folder.join("features.csv"), |out| write_true_features(out, features))?;
    }
    Ok(())
}

fn stage_observed(
    output: &mut OutputFolder,
    settings: &Settings,
    simulated: &Simulated,
) -> Result<()> {
    let Simulated { observed, truth, .. } = simulated;
    output.stage("observed/centers.csv", |out| write_centers(out, &observed.centers))?;
    output.stage("observed/features.csv", |out| write_features(out, &observed.features))?;
    let project = format!(
        "# plenocal project: observations drawn from the truth of a simulation, with noise.\n\n\
         {}\n{}\n[observations]\ncenters = \"centers.csv\"\nfeatures = \"features.csv\"\n",
        camera_text(settings),
        internal_text(&truth.internal)?,
    );
    output.stage("observed/project.toml", |out| out.write_all(project.as_bytes()))
}

/// Returns the name of a choice as written in files, quoted.
pub(super) fn name_of(choice: &impl Serialize) -> String {
    toml::Value::try_from(choice).map_or_else(|_| String::new(), |name| name.to_string())
}

fn write_true_centers(out: &mut dyn Write, centers: &[TrueCenter]) -> io::Result<()> {
    writeln!(out, "k,l,u,v,type,alive")?;
    centers.iter().try_for_each(|TrueCenter { center: c, lens_type, alive }| {
        let (lens_type, alive) = (lens_type + 1, u8::from(*alive));
        writeln!(out, "{},{},{},{},{lens_type},{alive}", c.k, c.l, c.u_px, c.v_px)
    })
}

fn write_true_features(out: &mut dyn Write, features: &[TrueFeature]) -> io::Result<()> {
    writeln!(out, "k,l,u,v,rho,cluster,frame,visible")?;
    features.iter().try_for_each(|TrueFeature { feature: f, visible }| {
        let (k, l, u, v) = (f.k, f.l, f.u_px, f.v_px);
        let rho = f.rho_px.map(|rho| rho.to_string()).unwrap_or_default();
        writeln!(out, "{k},{l},{u},{v},{rho},{},{},{visible}", f.corner, f.frame)
    })
}

fn internal_text(internal: &InternalParameters) -> Result<String> {
    let tables = BTreeMap::from([("internal_parameters", internal)]);
    toml::to_string(&tables)
        .map_err(|e| Error::invalid(format!("the internal parameters cannot be written: {e}")))
}

/// Formats the deviation of the board from a flat and exact one.
fn shape_text(target: &Target) -> String {
    format!(
        "# The shape of the board; see [target] in docs/simulation.md.\nsag_mm = {:?}\ntwist_mm = {:?}\n\
         aspect = {:?}\n",
        target.sag_mm, target.twist_mm, target.aspect
    )
}

/// Formats the tables of a project file that describe a datasheet.
fn camera_text(settings: &Settings) -> String {
    let (sheet, board) = (settings.datasheet(), settings.target.board());
    let configuration = name_of(&sheet.configuration);
    format!(
        "[sensor]\nwidth_px = {}\nheight_px = {}\npixel_size_mm = {}\n\n\
         [main_lens]\nfocal_length_mm = {}\nf_number = {}\nfocus_distance_mm = {}\n\n\
         [micro_lens_array]\nconfiguration = {configuration}\nlattice = \"{}\"\n\
         columns = {}\nrows = {}\nlens_types = {}\n\n\
         [board]\ncolumns = {}\nrows = {}\nsquare_mm = {}\n",
        sheet.sensor.width_px,
        sheet.sensor.height_px,
        sheet.sensor.pixel_size_mm,
        sheet.focal_length_mm,
        sheet.f_number,
        sheet.focus_distance_mm,
        sheet.lattice_kind.name(),
        settings.camera.lattice.columns,
        settings.camera.lattice.rows,
        sheet.lens_types,
        board.columns,
        board.rows,
        board.square_mm,
    )
}

fn project_text(settings: &Settings, data_set: &DataSet) -> String {
    let color = settings.imaging.color.name();
    let mut text = format!(
        "# plenocal project: a simulated camera. The truth is in truth/, the settings of the\n\
         # simulation in simulation.toml.\n\n{}\n\
         [images]\ncolor = \"{color}\"\ndevignetting = \"{}\"\n",
        camera_text(settings),
        image_name(Content::Devignetting, &data_set.devignetting)
    );
    let list = |subset: Subset, boards: &[(FramePose, Shot)]| {
        let name =
            |(p, shot): &(FramePose, Shot)| image_name(Content::Board(subset, p.frame), shot);
        let names = boards.iter().map(|board| format!("  \"{}\",\n", name(board)));
        format!("[\n{}]", names.collect::<String>())
    };
    let [calibration, evaluation, translation] = &data_set.subsets;
    let mut table = |line: String| text.push_str(&line);
    table(format!("calibration = {}\n", list(Subset::Calibration, calibration)));
    if !evaluation.is_empty() {
        table(format!("evaluation = {}\n", list(Subset::Evaluation, evaluation)));
    }
    for (i, shot) in data_set.whites.iter().enumerate() {
        table(format!(
            "\n[[images.whites]]\nimage = \"{}\"\nf_number = {}\n",
            image_name(Content::White(i), shot),
            shot.stated_f_number
        ));
    }
    if !translation.is_empty() {
        table(format!(
            "\n[images.translation]         # a board moved along the optical axis\n\
             step_mm = {}\nimages = {}\n",
            settings.translation.step_mm,
            list(Subset::Translation, translation)
        ));
    }
    table(
        "\n[truth]                      # to compare with\ncamera = \"truth/camera.json\"\n\
         board = \"truth/board.toml\"\n"
            .to_owned(),
    );
    for (subset, boards) in [(Subset::Calibration, calibration), (Subset::Evaluation, evaluation)] {
        if !boards.is_empty() {
            table(format!("{0}_poses = \"truth/{0}/poses.json\"\n", subset.name()));
        }
    }
    text
}
