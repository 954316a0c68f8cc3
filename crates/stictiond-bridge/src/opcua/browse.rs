//! Browsing the address space: the node that a text names, and the variables below a node.

use std::collections::{HashMap, HashSet, VecDeque};

use anyhow::{Context, anyhow, bail};
use futures_util::StreamExt;
use opcua::client::Session;
use opcua::client::browser::{BrowseFilter, BrowseResultItem, BrowserPolicy};
use opcua::types::{
    BrowseDescription, NamespaceMap, NodeClass, NodeClassMask, NodeId, ObjectId, ReferenceDescription, VariableTypeId,
};

use super::nodes::{Node, check_id, key_from, key_of};

/// Most nodes to browse.
const MAX_NODES: usize = 1_000_000;

/// Nodes found, and how many lack a unique key or name.
pub struct BrowsedNodes {
    /// Variables with keys made of their names below the start node.
    pub nodes: Vec<Node>,
    /// Number of variables left out.
    pub left_out: usize,
}

/// The node identifier at this server; namespace URIs are resolved there.
///
/// # Errors
/// Not a node identifier, or the server has no such namespace.
pub async fn node_id(session: &Session, id: &str, spaces: &mut Option<NamespaceMap>) -> anyhow::Result<NodeId> {
    let Some((uri, rest)) = id.strip_prefix("nsu=").and_then(|rest| rest.split_once(';')) else {
        return id.parse().map_err(|_| anyhow!("{id:?} is not a node identifier; write one such as ns=2;s=FIC101.OP"));
    };
    if spaces.is_none() {
        *spaces = Some(
            session.read_namespace_array().await.map_err(|e| anyhow!("cannot read the server's namespaces: {e}"))?,
        );
    }
    let index = spaces.as_ref().and_then(|map| map.get_index(uri));
    let index = index.ok_or_else(|| anyhow!("the server has no namespace {uri:?}; check the URI"))?;
    format!("ns={index};{rest}")
        .parse()
        .map_err(|_| anyhow!("{id:?} is not a node identifier; write one such as ns=2;s=FIC101.OP"))
}

/// The variables below a node, or below a path of browse names from the root, such as `/Objects/Plant`.
///
/// # Errors
/// There is no such node, or no variable below it.
pub async fn below(session: &Session, start: &str) -> anyhow::Result<BrowsedNodes> {
    let start_id = match start.strip_prefix('/') {
        Some(path) => at_path(session, path).await?,
        None => {
            check_id(start).map_err(|why| anyhow!("{why}, or a path such as /Objects/Plant"))?;
            node_id(session, start, &mut None).await?
        }
    };
    let children = children_of(session, start_id.clone(), true).await?;
    let found = walk(&start_id, &children);
    if found.nodes.is_empty() {
        bail!("no variables below {start}; start further up");
    }
    Ok(found)
}

type Children = HashMap<NodeId, Vec<ReferenceDescription>>;

async fn children_of(session: &Session, start: NodeId, deep: bool) -> anyhow::Result<Children> {
    let filter = BrowseFilter::new_hierarchical().node_class_mask(NodeClassMask::OBJECT | NodeClassMask::VARIABLE);
    let first: BrowseDescription = filter.new_description_from_node(start);
    let next = move |item: &BrowseResultItem| {
        let mut next = if deep { filter.get_next(item) } else { Vec::new() };
        // The server's own diagnostics are not process data.
        next.retain(|description| description.node_id != ObjectId::Server);
        next
    };
    let mut items = std::pin::pin!(session.browser().handler(next).max_nodes_per_request(100).run(vec![first]));
    let (mut children, mut count) = (Children::new(), 0);
    while let Some(item) = items.next().await {
        let item = item.map_err(|e| anyhow!("browsing: {e}"))?;
        if item.depth() == 1 && item.status().is_bad() {
            bail!("{}: {}", item.parent_id(), item.status());
        }
        let (parent, references) = item.into_results();
        count += references.len();
        if count > MAX_NODES {
            bail!("more than {MAX_NODES} nodes; start further down, such as --browse /Objects/Plant");
        }
        children.entry(parent).or_default().extend(references);
    }
    Ok(children)
}

/// Follows browse names from the root; `2:Plant` also names the namespace.
async fn at_path(session: &Session, path: &str) -> anyhow::Result<NodeId> {
    let mut at = NodeId::from(ObjectId::RootFolder);
    for name in path.split('/').filter(|name| !name.is_empty()) {
        let children = children_of(session, at.clone(), false).await?.remove(&at).unwrap_or_default();
        let numbered = name.split_once(':').and_then(|(space, name)| Some((space.parse::<u16>().ok()?, name)));
        let is_it = |child: &&ReferenceDescription| {
            let own = child.browse_name.name.as_ref();
            own == name || numbered == Some((child.browse_name.namespace_index, own))
        };
        let found = children.iter().find(is_it).with_context(|| {
            let names: Vec<&str> = children.iter().take(20).map(|child| child.browse_name.name.as_ref()).collect();
            format!("/{path} has no node {name:?}; choose one of {}", names.join(", "))
        })?;
        at = found.node_id.node_id.clone();
    }
    Ok(at)
}

/// Variables in breadth-first order: a node with several parents gets its name from the nearest.
fn walk(start: &NodeId, children: &Children) -> BrowsedNodes {
    let mut found = BrowsedNodes { nodes: Vec::new(), left_out: 0 };
    let (mut seen, mut keys) = (HashSet::from([start.clone()]), HashSet::new());
    let mut open = VecDeque::from([(start, Vec::<&str>::new())]);
    while let Some((parent, path)) = open.pop_front() {
        for child in children.get(parent).into_iter().flatten() {
            let id = &child.node_id.node_id;
            // Properties such as ranges and units are siblings of the measured values.
            let property = child.type_definition.node_id == VariableTypeId::PropertyType;
            if property || !seen.insert(id.clone()) {
                continue;
            }
            let mut path = path.clone();
            path.push(child.browse_name.name.as_ref());
            if child.node_class == NodeClass::Variable {
                let (id, mut key) = (id.to_string(), key_from(path.iter().copied()));
                if keys.contains(&key) {
                    key = key_of(&id);
                }
                if check_id(&id).is_ok() && keys.insert(key.clone()) {
                    found.nodes.push(Node { id, key });
                } else {
                    found.left_out += 1;
                }
            }
            open.push_back((id, path));
        }
    }
    found
}
