//! Names that other programs use for the networks here.
//!
//! A dialect is a row of [`DIALECTS`]: how to tell it by its names, where its tensors go, and what is done to those that differ in
//! size. It says in words what it does, so that nothing is renamed in silence.

use std::collections::{BTreeMap, BTreeSet};

use super::{StoredTensor, plain_name};
use crate::Blueprint;
use crate::blueprint::split_path;

/// Another program's way to store a network that is known here.
pub struct Dialect {
    /// What the file is.
    pub name: &'static str,
    /// What is done to it.
    pub note: &'static str,
    /// Names, one of each file that takes tensors: a network without them cannot have such weights.
    anchors: &'static [&'static str],
    /// Whether a file with these names is one.
    tells: fn(&BTreeSet<&str>) -> bool,
    /// Number of the anchor whose file takes a tensor, and its name there; `None` for what the network does not have.
    place: fn(&str) -> Option<(usize, String)>,
    /// Brings a tensor to the dimensions that the network has, where they differ in the way of this dialect.
    adapt: fn(StoredTensor, &[usize]) -> StoredTensor,
}

/// The tensors of a file under the names of a network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Translation {
    /// For each file of the network that is served: its tensors.
    pub files: BTreeMap<String, Vec<StoredTensor>>,
    /// Names that the network does not have, as they are in the file.
    pub left_out: Vec<String>,
}

/// Image encoder and decoder of the pose network with two files.
const POSE: &[&str] = &["encoder.conv1.weight", "net.0.weight"];

/// All of them.
pub const DIALECTS: &[Dialect] = &[
    Dialect {
        name: "pose network of sc_depth_pl",
        note: "'encoder.encoder.*' to 'encoder.*', 'decoder.conv_squeeze' and 'decoder.convs_pose.*' to 'net.*'; the second motion of \
               the last layer, which is never used, is filled with zeros",
        anchors: POSE,
        tells: |names| ["", "pose_net."].iter().any(|part| names.contains(format!("{part}decoder.convs_pose.0.weight").as_str())),
        place: |name| {
            let name = name.strip_prefix("pose_net.").unwrap_or(name);
            let layer = name.strip_prefix("decoder.conv_squeeze.").map(|rest| format!("0.{rest}")).or_else(|| {
                let (index, rest) = name.strip_prefix("decoder.convs_pose.")?.split_once('.')?;
                Some(format!("{}.{rest}", index.parse::<usize>().ok()? + 1))
            });
            pose_place(name, layer)
        },
        adapt: second_motion,
    },
    Dialect {
        name: "pose network of SC-SfMLearner",
        note: "'encoder.encoder.*' to 'encoder.*', 'decoder.net.*' to 'net.*'; the second motion of the last layer, which is never \
               used, is filled with zeros",
        anchors: POSE,
        tells: |names| names.contains("encoder.encoder.conv1.weight") && names.contains("decoder.net.0.weight"),
        place: |name| pose_place(name, name.strip_prefix("decoder.net.").map(str::to_owned)),
        adapt: second_motion,
    },
    Dialect {
        name: "ResNet of torchvision, trained on ImageNet",
        note: "names get the prefix 'encoder.'; for a stack of two images the weights of the first layer are repeated and halved",
        anchors: &["encoder.conv1.weight"],
        tells: |names| ["conv1.weight", "bn1.weight", "layer1.0.conv1.weight"].iter().all(|name| names.contains(name)),
        place: |name| Some((0, format!("encoder.{name}"))),
        adapt: repeated_inputs,
    },
    Dialect {
        name: "encoder of Lite-Mono, trained on ImageNet",
        note: "the norms behind the stages and the classifier ('norm*', 'head*') are left out",
        anchors: &["downsample_layers.0.0.conv.weight"],
        tells: |names| names.contains("downsample_layers.0.0.conv.weight") && names.iter().any(|name| name.starts_with("head")),
        place: |name| (!name.starts_with("norm") && !name.starts_with("head")).then(|| (0, name.to_owned())),
        adapt: |tensor, _| tensor,
    },
];

/// The dialect of a file with these names, if it is one for the network.
pub fn recognise<'a>(names: impl Iterator<Item = &'a str>, network: &Blueprint) -> Option<&'static Dialect> {
    let names: BTreeSet<&str> = names.map(plain_name).collect();
    DIALECTS.iter().find(|dialect| (dialect.tells)(&names) && dialect.files(network).is_some())
}

impl Dialect {
    /// The tensors under the names of the network, which must be one that [`recognise`] was asked about.
    pub fn translate(&self, tensors: Vec<StoredTensor>, network: &Blueprint) -> Translation {
        let files = self.files(network).unwrap_or_default();
        let sizes: BTreeMap<&str, &[usize]> =
            network.declarations().iter().map(|d| (d.path.as_str(), d.dims.as_slice())).collect();
        let mut translation = Translation::default();
        for mut tensor in tensors {
            let Some((file, name)) =
                (self.place)(plain_name(&tensor.name)).and_then(|(anchor, name)| Some((files.get(anchor)?, name)))
            else {
                translation.left_out.push(tensor.name);
                continue;
            };
            if let Some(dims) = sizes.get(format!("{file}:{name}").as_str()) {
                tensor = (self.adapt)(tensor, dims);
            }
            tensor.name = name;
            translation.files.entry(file.clone()).or_default().push(tensor);
        }
        translation
    }

    /// For each anchor the file that has it.
    fn files(&self, network: &Blueprint) -> Option<Vec<String>> {
        let file = |anchor: &&str| {
            let mut paths = network.declarations().iter().map(|d| split_path(&d.path));
            paths.find(|(_, name)| name == anchor).map(|(file, _)| file.to_owned())
        };
        self.anchors.iter().map(file).collect()
    }
}

/// Encoder and layers of a pose network that is one file.
fn pose_place(name: &str, layer: Option<String>) -> Option<(usize, String)> {
    match (name.strip_prefix("encoder."), layer) {
        (Some(name), _) => Some((0, name.to_owned())),
        (None, Some(layer)) => Some((1, format!("net.{layer}"))),
        (None, None) => None,
    }
}

/// Six outputs where the network has twelve: the other six are zero.
fn second_motion(mut tensor: StoredTensor, dims: &[usize]) -> StoredTensor {
    if let ([found, rest @ ..], [expected, others @ ..]) = (tensor.dims.as_slice(), dims)
        && rest == others
        && (*found, *expected) == (6, 12)
    {
        tensor.values.resize(tensor.values.len() * 2, 0.0);
        tensor.dims = dims.to_vec();
    }
    tensor
}

/// Weights for one image where the network takes a stack of several: the same for each, divided by their number.
fn repeated_inputs(mut tensor: StoredTensor, dims: &[usize]) -> StoredTensor {
    if let (&[outputs, inputs, h, w], &[expected_outputs, expected, expected_h, expected_w]) = (tensor.dims.as_slice(), dims)
        && (outputs, h, w) == (expected_outputs, expected_h, expected_w)
        && inputs > 0
        && expected.is_multiple_of(inputs)
    {
        let images = expected / inputs;
        let rows = tensor.values.chunks_exact((inputs * h * w).max(1));
        let repeated = rows.flat_map(|row| row.repeat(images)).map(|value| value / images as f64).collect();
        (tensor.values, tensor.dims) = (repeated, dims.to_vec());
    }
    tensor
}

#[cfg(test)]
mod tests {
    use super::super::{ElementType, assign};
    use super::*;
    use crate::{DepthNetKind, NetKind, Network, ParamSet, PoseNet, PoseNetConfig, PoseNetKind};
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{Shape, Tensor};

    fn stored(name: String, dims: &[usize], values: &[f64]) -> StoredTensor {
        StoredTensor { name, element: ElementType::F32, dims: dims.to_vec(), values: values.to_vec() }
    }

    fn loaded(net: &PoseNet, dialect: &str, tensors: Vec<StoredTensor>) -> ParamSet<f64> {
        let found = recognise(tensors.iter().map(|t| t.name.as_str()), &net.blueprint()).expect("recognised");
        assert_eq!(found.name, dialect);
        let translation = found.translate(tensors, &net.blueprint());
        let mut set = net.init::<f64>(9);
        for (file, tensors) in translation.files {
            assign(set.file_mut(&file), tensors, &file).unwrap();
        }
        set
    }

    #[test]
    fn pose_networks_in_one_file_give_the_same_motion() {
        let net = PoseNet::new(PoseNetConfig::nano());
        let params = net.init::<f64>(3);
        let images: Vec<Tensor<f64>> = [1, 2].map(|seed| random(seed, Shape::new(1, 3, 64, 64), 0.0, 1.0)).to_vec();
        let expected = net.predict(&params, &images[0], &images[1]);
        type Name = fn(usize) -> String;
        let names: [(&str, Name); 3] = [
            ("pose network of sc_depth_pl", |i| match i {
                0 => "decoder.conv_squeeze".to_owned(),
                _ => format!("decoder.convs_pose.{}", i - 1),
            }),
            ("pose network of sc_depth_pl", |i| match i {
                0 => "pose_net.decoder.conv_squeeze".to_owned(),
                _ => format!("pose_net.decoder.convs_pose.{}", i - 1),
            }),
            ("pose network of SC-SfMLearner", |i| format!("decoder.net.{i}")),
        ];
        for (dialect, name) in names {
            let of_run = name(0).starts_with("pose_net.");
            let one_file = params.iter().map(|(path, entry)| {
                let (file, own) = split_path(&path);
                let renamed = match own.strip_prefix("net.").and_then(|rest| rest.split_once('.')) {
                    Some((index, rest)) if file == "pose" => format!("{}.{rest}", name(index.parse().unwrap())),
                    _ => format!("{}encoder.{own}", if of_run { "pose_net." } else { "" }),
                };
                let mut tensor = stored(renamed, entry.dims(), entry.tensor().data());
                if own.starts_with("net.3.") {
                    tensor.dims[0] = 6;
                    tensor.values.truncate(tensor.values.len() / 2);
                }
                tensor
            });
            let mut one_file: Vec<StoredTensor> = one_file.collect();
            if of_run {
                one_file.push(stored("depth_net.decoder.weight".to_owned(), &[1], &[0.0]));
            }
            let set = loaded(&net, dialect, one_file);
            let found = net.predict(&set, &images[0], &images[1]);
            assert_eq!((found.0.data(), found.1.data()), (expected.0.data(), expected.1.data()), "{dialect}");
        }
    }

    #[test]
    fn imagenet_weights_go_to_an_encoder_of_one_or_two_images() {
        let depth = NetKind::Depth(DepthNetKind::NanoResnet);
        let pose = NetKind::Pose(PoseNetKind::Nano);
        for (net, file, images) in [(depth, "encoder", 1), (pose, "pose_encoder", 2)] {
            let network = net.blueprint();
            let source = network.init::<f64>(1);
            let imagenet = source.file(file).unwrap().iter().map(|(name, entry)| {
                let name = name.strip_prefix("encoder.").unwrap();
                let dims = [entry.dims().to_vec(), vec![16, 3, 7, 7]];
                match (name, images) {
                    ("conv1.weight", 2) => stored(name.to_owned(), &dims[1], &[0.5; 16 * 3 * 49]),
                    _ => stored(name.to_owned(), &dims[0], entry.tensor().data()),
                }
            });
            let imagenet: Vec<StoredTensor> = imagenet.collect();
            let found = recognise(imagenet.iter().map(|t| t.name.as_str()), &network).unwrap();
            let mut translation = found.translate(imagenet, &network);
            assert_eq!(translation.files.keys().collect::<Vec<_>>(), [file]);
            let mut set = network.init::<f64>(2);
            assign(set.file_mut(file), translation.files.remove(file).unwrap(), file).unwrap();
            let first = |set: &ParamSet<f64>| set.get(&format!("{file}:encoder.conv1.weight")).unwrap().tensor().to_vec();
            assert_eq!(first(&set), if images == 2 { vec![0.25; 16 * 6 * 49] } else { first(&source) });
        }
    }

    #[test]
    fn the_first_layer_is_repeated_and_halved() {
        let tensor = stored("w".to_owned(), &[2, 1, 1, 2], &[1.0, 2.0, 3.0, 4.0]);
        let twice = repeated_inputs(tensor.clone(), &[2, 2, 1, 2]);
        assert_eq!((twice.dims, twice.values), (vec![2, 2, 1, 2], vec![0.5, 1.0, 0.5, 1.0, 1.5, 2.0, 1.5, 2.0]));
        for dims in [&[2, 1, 1, 2][..], &[3, 2, 1, 2], &[2, 2, 2, 2], &[2]] {
            assert_eq!(repeated_inputs(tensor.clone(), dims), tensor);
        }
    }

    #[test]
    fn the_norms_and_the_classifier_of_a_pretrained_encoder_are_left_out() {
        let network = NetKind::Depth(DepthNetKind::NanoLiteMono).blueprint();
        let source = network.init::<f64>(1);
        let mut tensors: Vec<StoredTensor> = source
            .file("encoder")
            .unwrap()
            .iter()
            .map(|(name, entry)| stored(name.to_owned(), entry.dims(), entry.tensor().data()))
            .collect();
        let own = tensors.len();
        for name in ["norm.weight", "norm0.bias", "head.weight"] {
            tensors.push(stored(name.to_owned(), &[1], &[0.0]));
        }
        let translation = recognise(tensors.iter().map(|t| t.name.as_str()), &network).unwrap().translate(tensors, &network);
        assert_eq!(translation.left_out, ["norm.weight", "norm0.bias", "head.weight"]);
        assert_eq!(translation.files["encoder"].len(), own);
        assign(network.init::<f64>(2).file_mut("encoder"), translation.files["encoder"].clone(), "x").unwrap();
    }

    #[test]
    fn the_names_of_a_network_itself_are_no_dialect_of_it() {
        for net in NetKind::all() {
            let blueprint = net.blueprint();
            let files: BTreeSet<&str> = blueprint.declarations().iter().map(|d| split_path(&d.path).0).collect();
            for file in files {
                let names = blueprint.declarations().iter().map(|d| split_path(&d.path)).filter(|path| path.0 == file);
                assert!(recognise(names.map(|path| path.1), &blueprint).is_none(), "{net} {file}");
            }
        }
    }
}
